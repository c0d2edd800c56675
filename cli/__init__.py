"""The ``idapt`` command."""
