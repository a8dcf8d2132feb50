"""Pure numerics, no hardware: spectra of recordings and the stimuli made from them."""
