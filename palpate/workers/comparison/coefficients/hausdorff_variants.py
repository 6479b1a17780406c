"""The 24 modified Hausdorff distances (Eqs. 3.20 to 3.29 and Table 3.1 of the thesis)."""

from palpate.workers.comparison.coefficients.directed import DirectedDistances

# D1 to D4 combine minima and are zero whenever the sets touch; the thesis omits them.
FIRST_KEPT = 5
VARIANTS = tuple(range(FIRST_KEPT, 25))
HAUSDORFF, MODIFIED_HAUSDORFF = 18, 22


def hausdorff_variants_mm(to_y: DirectedDistances, to_x: DirectedDistances) -> dict[int, float]:
    r"""Combine the directed distances in both directions, ``D[4 (i - 1) + j] = f_j(d_i)``.

    .. math:: f_1 = \min, \quad f_2 = \max, \quad f_3 = \text{mean}, \quad
              f_4 = \frac{N_X d(X, Y) + N_Y d(Y, X)}{N_X + N_Y}

    Parameters
    ----------
    to_y, to_x : DirectedDistances
        Distances from X to Y, and from Y to X.

    Returns
    -------
    dict of int to float
        D1 to D24 in mm; D18 is the Hausdorff distance, D22 the modified one.

    References
    ----------
    .. [1] M.-P. Dubuisson, A. K. Jain, A modified Hausdorff distance for object
       matching, Proc. 12th ICPR, 1994.
    """
    n_x, n_y = to_y.count, to_x.count
    variants: list[float] = []
    for x, y in zip(to_y.directed_mm, to_x.directed_mm, strict=True):
        weighted = (n_x * x + n_y * y) / (n_x + n_y)
        variants += [min(x, y), max(x, y), (x + y) / 2, weighted]
    return dict(enumerate(variants, start=1))
