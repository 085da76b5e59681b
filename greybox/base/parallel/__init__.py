"""Many jobs here, in processes of this machine, or on a cluster."""
