"""Multi-chain tracking: dynamic models of one scene that share latent features and correct each other.

The subpackages, each of which imports only from those before it: `rsmcm.models`, `rsmcm.inference`,
`rsmcm.chains`, `rsmcm.apps`.
"""

__version__: str


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version  # which takes longer than the rest of this import

    return version(__name__)
