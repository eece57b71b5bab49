"""The map as it grows, in a browser: a page of our own, served by a process of its own.

`client`: the end that the engine holds; it never waits. `__main__`: the process. `server`: HTTP and one stream of
events per browser. `snapshot`: what is shown, and what one browser does not have of it yet. `tiles`: the map in
pieces. `run`: a finished run instead of a live one. ``page/``: what the browser gets.
"""
