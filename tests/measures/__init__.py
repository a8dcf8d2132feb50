"""What `tests.figures` counts: trunks and wings, complexity, parameters, sentences in tests, decisions by kind."""
