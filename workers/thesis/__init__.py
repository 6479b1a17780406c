"""The experiments of the thesis, as pure functions of a scale.

Ranked above the organs, because the cantilever bar is a specimen and the phantoms are
breasts, and organs do not import each other.
"""
