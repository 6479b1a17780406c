"""Diagnoses and plans: requests to the workers, and reports to the user."""
