"""The service: a queue of studies and diagnoses on one cluster, behind an HTTP API."""
