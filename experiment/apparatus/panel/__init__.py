"""What shakes the panel, and what hears it: `conditioning` limits samples, `pcm` sends them, `response_table` reads."""
