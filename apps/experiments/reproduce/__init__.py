"""The papers' experiments anew, one a file: what is wanted of them beside what is measured."""
