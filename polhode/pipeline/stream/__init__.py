"""The stages of one pair after the other, for live streams and long sequences.

In: pairs in the order of time. Out: a state after each, and what the batch need not find again.

- stream: features, links with earlier frames, landmarks, window; what is known after a pair
- work_ahead: what the batch will want of each pair, done in another process meanwhile; the growing surface
"""
