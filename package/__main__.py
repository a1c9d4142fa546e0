"""`python -m rsmcm` is the command `rsmcm`."""

from .apps.command_line import main

if __name__ == "__main__":
    main()
