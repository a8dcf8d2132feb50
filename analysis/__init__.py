"""What an analyst makes of a dataset on disk: tables, tests, figures, one report."""
