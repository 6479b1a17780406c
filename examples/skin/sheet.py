"""Write the tables of sheet.yaml from images and forces of living skin.

    python examples/skin/sheet.py FOLDER OUT

FOLDER is ``examples/human_skin/monolithic`` of
github.com/aflahelouneg/inverse_identification_soft_tissue (MIT licence; Elouneg et al. 2021,
Comput. Methods Appl. Mech. Eng. 373:113503): points at rest (x0, y0), the same at 49 moments
(xt, yt), and marks on both pads. OUT receives sheet.yaml and a table for each state.
"""

import shutil
import sys
from pathlib import Path

import numpy as np

FRAMES = (14, 26, 38, 49)
EVERY = 3  # of the 10 px between neighbouring points
MARKS_MM = 24.0  # between the two marks on a pad
MOVING_PAD_MM = (30.0, 24.0)  # middle of its marks in the frame of the sheet


def main(folder: Path, out: Path) -> None:
    def read(name: str) -> np.ndarray:
        return np.loadtxt(next(folder.rglob(f"{name}.dat")))

    rest = np.stack([read("x0"), read("y0")])
    moved = np.stack([read("xt"), read("yt")])
    marks = [np.stack([read(f"{a}0_ref_{pad}") for a in "xy"]) for pad in (1, 2)]
    fixed_pad = np.stack([read(f"{a}t_ref_2") for a in "xy"])
    mm = MARKS_MM / np.mean([abs(np.diff(one[1])[0]) for one in marks])
    origin = np.array(MOVING_PAD_MM) - mm * marks[0].mean(axis=1)
    _, columns = np.unique(rest[0], return_inverse=True)
    _, rows = np.unique(rest[1], return_inverse=True)
    chosen = (columns % EVERY == 0) & (rows % EVERY == 0)
    out.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).with_name("sheet.yaml"), out)
    for frame in FRAMES:
        drift = (fixed_pad[..., frame - 1] - marks[1]).mean(axis=1)
        u = mm * (moved[..., frame - 1] - rest - drift[:, None])
        table = np.column_stack([(origin[:, None] + mm * rest).T, u.T])[chosen]
        head = "x_mm,y_mm,ux_mm,uy_mm"
        np.savetxt(out / f"frame_{frame}.csv", table, "%.5f", ",", header=head, comments="")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
