"""Reports that anyone can rerun: stability, and error against run time. Like the facade they join both halves."""
