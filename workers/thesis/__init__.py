"""The experiments of the thesis, as pure functions of a scale.

Above the organs, because the cantilever bar is a specimen and the phantoms are
breasts, and no organ knows another.
"""
