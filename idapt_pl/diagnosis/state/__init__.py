"""Where a search stands: its settings, what stays the same, its windows, and the model in the making."""
