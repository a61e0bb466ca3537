"""Reports: results and figures put together into one page that needs nothing else."""
