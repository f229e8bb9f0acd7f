"""How frames travel: a local bus for bare machines, and the asyncio driver that runs any core.

Knows no messages: a frame is an identifier and bytes here.
"""
