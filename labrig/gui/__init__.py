"""The operator's window: tkinter and no science; a panel a file."""
