"""What a dataset holds of each kind of trial, beside the cells that rows of all kinds share.

A kind is a module that is named as in a protocol file and has a `DATASET`; it never imports another. `build.kind_of`
imports it when it is looked up, so that a session brings along no kind but its own.
"""
