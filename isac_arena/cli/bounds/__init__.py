"""Commands of lower bounds: `bound` over a plan, `place` for TX."""
