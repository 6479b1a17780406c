"""Definitions of the terms on a page, one sentence each."""

STUDY = (
    ("Candidate", "One proposal of the search: a value for every searched constant."),
    ("Generation", "The candidates proposed together, counted from 1."),
    ("Elite", "The best candidates of a generation, kept unchanged in the next."),
    ("Target", "The deformed body that the simulation should match."),
    (
        "E, η",
        "Young's modulus and fibre stiffness: how strongly a tissue resists, in all directions "
        "and along its fibres.",
    ),
    (
        "Jaccard (JC)",
        "Volume of the intersection of two bodies, divided by the volume of their union: 1 if "
        "equal.",
    ),
    ("Dice", "Twice the volume of the intersection, divided by the sum of both volumes."),
    (
        "MHD",
        "Modified Hausdorff distance: the mean distance between two surfaces, the larger of the "
        "two directions.",
    ),
    ("GSF", "ln((1 − Jaccard) · MHD in voxels); lower is better."),
    (
        "Weakly determined",
        "The interval is wider than half the value: other values explain the images almost as "
        "well.",
    ),
)

DIAGNOSIS = (
    ("Gap", "Root mean square difference of model and data beyond the noise, in mm."),
    (
        "Noise",
        "Standard deviation of the error of the segmentation, or of a marker's recording, at one "
        "point.",
    ),
    ("Nominal model", "The model without any suspected effect, with fitted constants."),
    ("Effect", "A cause missing from the model, with a magnitude that can be fitted."),
    ("Evidence, nats", "A gain of 3 makes a hypothesis 20 times as probable."),
    (
        "Alarm",
        "The evidence for a gap that noise alone exceeds in 5 of 100 cases.",
    ),
    (
        "Absorbed by constants",
        "The part of an effect that other constants could mimic; if it is large, the effect is "
        "neither confirmed nor ruled out.",
    ),
    ("On unseen scans", "Each scan is compared with a fit to the others."),
)
# For scans; a bench has no overlap.
OVERLAP = (
    ("JC, MHD, GSF", "Jaccard coefficient, modified Hausdorff distance, and ln((1 − JC) · MHD)."),
)
