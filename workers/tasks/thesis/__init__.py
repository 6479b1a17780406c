"""The experiments of the thesis as tasks: a small request in, a small record out.

Every task leaves its part in the store under the digest of the request and of the code that
it imports, so an experiment that is killed goes on where it was.
"""
