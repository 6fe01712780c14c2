"""The papers' convergence experiments, run again."""
