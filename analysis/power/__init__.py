"""How many participants a study needs.

A protocol and a model of how participants answer come in. Whole simulated studies are tested as the protocol plans, by
the functions of `statistics` that `analyse` uses. Power, its Monte Carlo error and the type I error come out. Nothing
here is about anybody who took part, and everything says so.
"""
