"""Frames, cameras, rigid bodies and rays: the mathematics that every room shares."""
