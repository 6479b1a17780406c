"""The functions that Dask workers run, and the store that they share."""
