"""What the files of a run folder say: its config, and the target interactions that they hold."""
