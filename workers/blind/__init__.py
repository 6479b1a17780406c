"""Make cases whose truth is known: another solver, other forms of every effect, sealed noise."""
