"""Remote: a dataset file or an export at a URL, brought there and back whole or not at all."""
