/* Contact forces and accelerations of a substep, in as many unknowns as there are contact rows. */
#ifndef CATHSIM_CONTACT_SOLVER_H_
#define CATHSIM_CONTACT_SOLVER_H_

#include <mujoco/mujoco.h>

#define SOLVER_ROWS 256 /* contact rows above which MuJoCo's own solver is left to it: with convex hulls, say */

/* Numbers that `contact_solve` needs as workspace, with so many degrees of freedom. */
int cathsim_solver_workspace(int nv);

/* Whether `contact_solve` knows all constraints of the moment, at most `rows` of them: frictionless contacts, and elliptic
 * cones in 3 rows. */
int contact_solvable(const mjModel* m, const mjData* d, int rows);

/* Solves for the acceleration and the forces of all contacts, to rounding, under the discrete integrator: positions,
 * velocities, constraints and the acceleration without them are those of `d`. Sets qacc, qfrc_constraint, efc_force and the
 * number of iterations. */
void contact_solve(const mjModel* m, mjData* d, double* workspace);

#endif
