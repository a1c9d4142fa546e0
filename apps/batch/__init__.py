"""Many films, many cameras: a run for each, in processes on this machine or on a Dask cluster."""
