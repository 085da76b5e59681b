"""The plants of this project: equations and sourced numbers, nothing else."""
