"""Solvers of the weighted nonlinear least-squares problem: data and a start in, an optimum out.

- ``solve``: the choice of the solver; by default Gauss-Newton to the optimum, IPOPT for the answer.
- ``gauss_newton``: damping and line search; also the source of covariances.
- ``ipopt``: the whole problem stated as one nonlinear program, solved by IPOPT: the answer of a default run.
- ``linearization_point``: what stays fixed during one solve.
- ``robust_kernel``: the Cauchy kernel of the stereo residuals.
- ``schur``: normal equations of the stereo measurements, elimination of the landmarks.
- ``chain``: elimination of velocities and rates, which couple neighbouring frames only.
- ``casadi_nlp``: assembly of CasADi programs from blocks, and the set-up of IPOPT.
"""
