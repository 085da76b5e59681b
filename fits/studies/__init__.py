"""Studies of many cases: how often something is right, and the cases, twins and pages that they share."""
