"""mpdt: multi-task offline-RL datasets and prompt-tuned Decision Transformers."""

__version__ = "0.1.0"
