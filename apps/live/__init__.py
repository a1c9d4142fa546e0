"""`--live`: a run that goes on, shown in the browser while it does.

The run loop opens a `server.live_page` before anything is written, and tells its `server.Running` of every
frame; the picture is drawn as for `overlay.mp4`. Threads of the server ask for what is
newest: no run ever waits for somebody who looks, and nothing is encoded while nobody does.
"""
