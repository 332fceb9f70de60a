"""Reports: from result files to tables and figures. Reads files and nothing else."""
