"""Pages made from what experiments have recorded: `python -m rsmcm.apps.experiments.results`."""
