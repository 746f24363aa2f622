"""The error budget: where the final pose and shape errors of a campaign come from."""
