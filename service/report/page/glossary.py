"""What the words of a page mean, one sentence each."""

STUDY = (
    ("Candidate", "One proposal of the search: a value for every searched constant."),
    ("Generation", "The candidates that are proposed together, counted from 1."),
    ("Elite", "The best candidates of a generation, which live on unchanged."),
    ("Target", "The deformed body that is to be explained."),
    (
        "E, η",
        "Young's modulus and fibre stiffness: how strongly a tissue resists, in all directions "
        "and along its fibres.",
    ),
    ("Jaccard (JC)", "What two bodies share, over what they fill together: 1 if they are equal."),
    ("Dice", "Twice what they share, over the sum of both."),
    (
        "MHD",
        "Modified Hausdorff distance: the mean distance of two surfaces, the larger of both "
        "directions.",
    ),
    ("GSF", "ln((1 − Jaccard) · MHD in voxels), which the search makes as small as it can."),
    (
        "Weakly determined",
        "Its interval is wider than half its value: other values explain the images nearly as "
        "well.",
    ),
)

DIAGNOSIS = (
    ("Gap", "What model and data differ by beyond the noise, root mean square, in mm."),
    (
        "Noise",
        "What the segmentation, or the recording of a marker, errs by at one point: a standard "
        "deviation.",
    ),
    ("Nominal model", "The model without any of the suspected effects, at its best constants."),
    ("Effect", "A cause that the model leaves out, with a magnitude that can be fitted."),
    ("Evidence, nats", "A gain of 3 makes a hypothesis 20 times as probable."),
    (
        "Alarm",
        "The evidence for a gap that noise alone exceeds in 5 of 100 cases.",
    ),
    (
        "Hidden in constants",
        "What another choice of the constants would look like too: it is neither accused nor "
        "acquitted.",
    ),
    ("On unseen scans", "Each scan is judged by a fit to the others."),
    ("JC, MHD, GSF", "Jaccard coefficient, modified Hausdorff distance, and ln((1 − JC) · MHD)."),
)
