"""Data sets for learning: `arena dataset` makes one, `ia.datasets.open` reads it.

`config.py` states one, `making.py` makes its shards on workers, `samples.py` what a stop holds, `shards.py` the
files, `reading.py` the map and the stream over them, `datasheet.py` what accompanies them.
"""

from isac_arena.datasets.making import behind, make
from isac_arena.datasets.reading import Dataset, SampleStream, open_dataset

open = open_dataset

__all__ = ["Dataset", "SampleStream", "behind", "make", "open", "open_dataset"]
