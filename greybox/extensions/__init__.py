"""What stands beside the core and is found through entry points: file formats, exports, FMUs, design, changes, the app."""
