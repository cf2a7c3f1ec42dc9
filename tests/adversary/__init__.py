"""An adversary: bad and extreme inputs, signals and kills, drawn at random but repeatably.

Each module in `CLASSES` draws one class of inputs. `python -m adversary --count 2000` from the
folder `tests`, or `make adversary`, tries them and prints a table; each fault comes with the
line that repeats it alone.
"""
