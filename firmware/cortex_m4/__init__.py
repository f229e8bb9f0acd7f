"""The linked image of the board, run as Cortex-M4 instructions: processor and STM32G474, emulated.

Written from the reference manual of the STM32G4 (RM0440) and the ARMv7-M architecture manual, apart
from the firmware's own board layer: each is a witness of the other. The manuals were not at hand
page by page: chapters and registers are named, and layouts were held against ST's device header.
Never compared with silicon.

Code takes no time here: the clock stands while instructions run, and goes on while they sleep.
"""
