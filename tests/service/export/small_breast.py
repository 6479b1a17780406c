"""The small breast exported by the tests."""

PHANTOM = {"preset": "445ml", "spacing_mm": 2.0, "seed": 1}
CASE = {
    "organ": "breast",
    "reference": {"phantom": PHANTOM},
    "mesh": {"nodes": 1000},
    "load": {"force_n": 60},
}
CONSTANTS = {"E_fat": 0.01, "E_glandular": 0.04, "eta_fat": 0.05, "eta_glandular": 0.05}
