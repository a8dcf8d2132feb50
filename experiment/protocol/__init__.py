"""What a study is, as its ethics board approves it.

A protocol file comes in; its model (`models`, with what must hold between fields in `rules`), its canonical hash and
seal (`approval`) and the board's page (`page`) go out. This room knows neither rigs nor participants nor what was
answered: a protocol is the same in every laboratory.
"""
