/* Stepping a wire in a vessel, with contact forces and adaptive substeps. */
#ifndef CATHSIM_STEP_H_
#define CATHSIM_STEP_H_

#include "blood.h"
#include "rod.h"
#include "vessel.h"

#define FIRST_HALF 11 /* functions */

/* MuJoCo's functions; their addresses come from the running library, so nothing is linked against it. */
typedef struct {
  void (*first_half[FIRST_HALF])(const mjModel* m, mjData* d); /* mj_step1 without the factor of the mass alone */
  void (*forward)(const mjModel* m, mjData* d, int skip_stage, int skip_sensors); /* mj_forwardSkip and mj_step2 */
  void (*second_half)(const mjModel* m, mjData* d);
  void (*kinematics)(const mjModel* m, mjData* d);
  void (*contact_force)(const mjModel* m, const mjData* d, int id, mjtNum result[6]);
  void (*check_acceleration)(const mjModel* m, mjData* d);
  void (*integrate)(const mjModel* m, mjtNum* qpos, const mjtNum* qvel, mjtNum h); /* mj_integratePos */
} Engine;

/* A simulation: `fine` is `model` with a timestep `refinement` times shorter, `finest` is `fine` likewise. */
typedef struct {
  const mjModel* model;
  const mjModel* fine;
  const mjModel* finest;
  mjData* data;
  double* saved;          /* memory for nq + 2 nv numbers */
  double* workspace;      /* for cathsim_solver_workspace(nv) numbers */
  int solver_rows;        /* contact rows up to which this code solves, at most SOLVER_ROWS; 0: MuJoCo does */
  int vessel_geom;
  int hulls;              /* convex hulls that stand for its wall: the geoms after it; 0: the grid makes the contacts */
  int first_geom;         /* the wire's capsules are geoms first_geom..last_geom */
  int last_geom;
  int refinement;         /* 1: never refine */
  double tolerance;       /* a substep that ends deeper than this in the wall is repeated with `fine`, m */
  double rise;            /* ... if it also went in by more than this, m */
  double deep;            /* a repetition that ends so many tolerances deep is itself repeated with `finest` */
  int depth_samples;      /* points a capsule of the reported penetration; 0: not reported */
  double depth;           /* penetration at the end of the last substep, m */
  const Drag* drag;       /* of the blood on the wire; NULL: there is none */
  double* loads;          /* memory for that on each link: 6 numbers */
  double wall_stiffness;  /* of each contact with the wall, N/m; 0: as the wire's geoms say */
  Rod* rod;               /* two devices; NULL: the chain is a bare wire */
  double breath[3];       /* farthest displacement of the vessel by breathing, m */
  double breath_rate;     /* rad/s; 0: it does not move */
} Simulation;

typedef struct {
  double force[3];          /* resultant of the wall's contact forces on the wire where its norm is largest, N, world */
  double force_max;         /* that norm, N */
  double force_mean;        /* mean norm over the substeps, N */
  double penetration_max;   /* deepest point of the wire's surface in the wall over the substeps, m */
  int contacts;             /* contacts with the vessel (the sheath left out) in the substep of the largest force */
  int refined;              /* substeps that were repeated */
  int warnings;             /* nonzero: MuJoCo found the state invalid */
  double mean_force[3];     /* time mean over the control step of the wall's resultant on the wire, N, world */
  double sheath_force[3];   /* likewise of the sheath's */
  double magnitude_sum;     /* time mean of the sum of the wall's contact force magnitudes, N */
  double contact_max;       /* largest single contact force of the wall over the substeps, N */
} StepSummary;

int cathsim_contact_forces(const Simulation* s, const Engine* engine, int capacity, double* points, double* forces);
double cathsim_penetration(const Simulation* s, int samples);
void cathsim_step(Simulation* s, const Engine* engine, int substeps, const double* control_from, const double* control_to,
                  int capacity, double* points, double* forces, double* scratch, double* depths, StepSummary* summary);

#endif
