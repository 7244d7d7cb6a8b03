"""An approach after an inspection, flown on rendered images: whether it arrives as promised.

In: what an inspection of rendered pairs gives, its motion and its mesh. Out: errors and consistency on
arrival. README.md beside this file has what they gave.

    inspect_and_approach  the whole loop: tables of errors on arrival against what was promised
    inspections           rendered pairs and their run, kept
    approach_flights      plan, images, tracked poses
    arrivals              sizes of errors from other bodies; the filter on recorded poses
    body_filter           the filter: motion, inertia, centre of mass and errors of the mesh
    mesh_errors           what errors of the edges do to a pose
    refined_edges         how far the edges of runs are from the true ones, before and after refinement
"""
