"""How shafts move: equations of motion, closed forms, the brake's input, signs."""
