"""How measurements of speed are made and judged: stages, the limits of the machine, records compared."""
