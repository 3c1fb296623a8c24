"""The amplifiers' side of the bus: tensions to the frames that real ones send, faults on request.

No hardware is needed, and none is imitated beyond its frames: there is no arbitration, no bit
timing and no bus that could fail. Error frames and bus off are put in as frames.
"""
