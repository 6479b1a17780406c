"""The experiments of the thesis, as pure functions of a scale.

They rank above the organs, because the cantilever bar is a specimen, the phantoms are breasts, and
organs do not import each other.
"""
