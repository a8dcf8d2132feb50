"""The validation of the synthesis, section 3.3 of Okamoto et al.

Recordings and fresh takes come in, as arrays; which speed each take is put on, how alike materials are, tables and
figures come out. The room reads no recordings and opens no device.
"""
