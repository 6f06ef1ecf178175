"""What is known about targets that were missed, and what the next factor of two would need.

Printed by performance_page.py into docs/performance.md; MISSES only where one was missed.
"""

from __future__ import annotations

MISSES = {}
FLOORS = {}
