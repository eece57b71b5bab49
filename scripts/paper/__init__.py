"""The paper's experiments on the simulator, section by section; `scripts/reproduce_paper.py` runs them."""
