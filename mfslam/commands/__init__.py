"""What the commands do, one module each; `mfslam.cli` parses and dispatches."""
