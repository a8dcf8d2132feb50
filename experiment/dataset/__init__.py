"""The study's BIDS dataset: `build` makes it from journals, `reconstruction` from counts in print.

Both write through `bids`, which knows the layout. This room reads only what is on disk, and knows neither devices that
are open nor how anything is analysed.
"""
