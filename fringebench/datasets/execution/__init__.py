"""Who makes the samples: processes of this machine, or a Dask cluster."""
