"""How it rides: weightings, comfort indices, frequency response, statistical linearisation.

Imports base, model, dampers and simulation; knows nothing of stability."""
