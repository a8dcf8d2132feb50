"""One participant doing one task: states, journal, runner, resume."""
