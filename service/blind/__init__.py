"""Diagnoses of cases whose cause is known to somebody else: made, sealed, answered, scored."""
