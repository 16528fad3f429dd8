"""Maps of all kinds, driven on by both engines: does everybody get through, and what is wrong?"""
