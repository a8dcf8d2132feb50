"""Settings files: TOML read as frozen, strict models, with every error at once, in words and on its line.

A file and a model come in; the model's values go out, or a `ProtocolError` with everything that is wrong. Protocols,
rigs, manifests of recordings, printed numbers and models of choice are all read here, and none of them is known here:
each room declares its own models upon `model.Confined`.
"""
