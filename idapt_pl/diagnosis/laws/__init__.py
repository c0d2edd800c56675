"""A law of force where the library of effects ends: where it acts, which terms it has, how it is fitted and tested."""
