"""Keep-out volumes and exported bodies against the truth.

In: stored runs, sequences with truth. Out: shares of draws inside, volumes, distances.

    keepout            the keep-out volume over independent draws, and against the true body
    collision_pieces   convex pieces of exported bodies
"""
