"""Functions run by Dask workers, and the store that they share."""
