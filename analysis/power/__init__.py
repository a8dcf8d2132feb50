"""How many participants a study needs.

A protocol and a model of how participants answer come in; whole simulated studies are tested as the protocol plans, by
the functions of `statistics` that `analyse` uses; power, its Monte Carlo error and the type I error come out. Nothing
of it is about anybody who took part, and everything says so.
"""
