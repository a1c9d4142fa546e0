"""Where, when and from what a record that is made up was measured."""

from rsmcm.apps.experiments.record import Provenance

MADE = Provenance(
    date="2026-11-22T10:00:00+00:00",
    seconds=30.0,
    commit="0123456789",
    changed=False,
    processor="Processor",
    cores=2,
    memory=24.0,
    load=0.25,
    threads=1,
    versions={"python": "3.11.7", "rsmcm": "0.1.0"},
)
