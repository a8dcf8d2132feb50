"""Puts on the mask that the environment names: `site` imports this from PYTHONPATH as Python starts."""

from tests.portable import masks

masks.put_on()
