"""Reports: figures with the paper's numbers, and pages that need nothing else."""
