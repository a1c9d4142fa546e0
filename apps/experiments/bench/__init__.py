"""Speed beside peers, and cost as curves: `python -m rsmcm.apps.experiments.bench`."""
