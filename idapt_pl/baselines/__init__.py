"""References and baselines that the method is compared with."""
