"""What the commands can be told, by kind; the commands themselves are in `mfslam.commands`."""
