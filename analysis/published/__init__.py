"""The numbers that the papers print, with where each stands."""
