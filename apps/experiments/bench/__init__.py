"""Speed beside peers: `python -m rsmcm.apps.experiments.bench`."""
