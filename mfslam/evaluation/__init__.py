"""Results held against a truth, or against each other."""
