"""What `bench.serve` measures servers with, over TCP only.

`process` runs the server of a source tree, `clients` are many clients in one loop, `figures` gathers figures
of several runs. The parts: `robots` (INIT to the first STA), `gaps` (reports that are late while others join,
leave and talk; pictures), `load` (processor time, and how soon a command shows). They know of the server no
more than its ports and its processor time, so that older ones can be measured as well. Begin with `robots`.
"""
