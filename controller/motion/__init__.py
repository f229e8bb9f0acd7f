"""How shafts move: models, their closed forms and kernels, predictors, the brake input."""
