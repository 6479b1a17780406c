"""The geometric similarity function, which the search minimises."""

import math


def gsf(jc: float, mhd_voxels: float) -> float:
    r"""Return the geometric similarity function :math:`\ln((1 - JC) \cdot MHD)` (thesis, Eq. 3.31).

    Parameters
    ----------
    jc : float
        Jaccard coefficient, 0 to 1.
    mhd_voxels : float
        Modified Hausdorff distance in voxels, >= 0 or inf. Another unit would only add a constant
        to the function.

    Returns
    -------
    float
        ``-inf`` if the product is zero: for identical sets, or for a solid compared, by boundary
        distances, with its own layer of boundary voxels.

    Examples
    --------
    >>> gsf(0.5, 2.0)
    0.0
    >>> gsf(1.0, 0.0)
    -inf
    """
    product = 0.0 if mhd_voxels == 0.0 else (1.0 - jc) * mhd_voxels
    return math.log(product) if product > 0.0 else -math.inf
