from palpate.library import audit as audit
from palpate.library import compare as compare
from palpate.library import contact as contact
from palpate.library import crinkle as crinkle
from palpate.library import detect as detect
from palpate.library import identify as identify
from palpate.library import power as power
from palpate.library import rate as rate
from palpate.library import read as read
from palpate.library import spectrum as spectrum

__version__: str
__all__: list[str]
