/* Blood in a vessel: its velocity about the centrelines, and its drag on a wire. */
#ifndef CATHSIM_BLOOD_H_
#define CATHSIM_BLOOD_H_

#include "vessel.h"

/* One row of `samples`: a point of a centreline and its vessel's section. */
typedef struct {
  double centre[3];      /* m */
  double along[3];       /* unit vector downstream */
  double share;          /* share of the inlet's flow over the section's area, 1/m^2 */
  double inverse_square; /* 1 / radius^2, 1/m^2 */
  double row;            /* which row of the table: its radius */
} BloodSample;

typedef struct {
  int size[3];            /* nodes of a coarse grid along x, y, z; z is contiguous */
  double origin[3];       /* m */
  double inverse;         /* 1 / distance of nodes, 1/m */
  const int* nodes;       /* nearest sample of the vessel that the node lies in; -1 far outside */
  const BloodSample* samples;
  const double* table;    /* velocity times area, m^3/s: (phases + 1) x rows x columns; columns by squared radius */
  int phases;
  int rows;
  int columns;
  double frequency;       /* of the heartbeat, Hz; 0: steady */
  double start;           /* phase at time zero */
} Blood;

/* Drag of a cylinder for each metre: coefficients of the relative velocity across and along it. */
typedef struct {
  const Blood* blood;
  double across_viscous;  /* N s/m^2 */
  double along_viscous;   /* N s/m^2 */
  double across_layer;    /* times sqrt(velocity across): N s/m^2 (m/s)^-1/2 */
  double along_layer;     /* likewise */
  double across_inertial; /* times velocity across: N s^2/m^3 */
  double spacing;         /* a link is cut into equal parts no longer than this, m */
} Drag;

/* Velocity (m/s) of the blood at a point (m) at a time (s). */
void blood_velocity(const Blood* b, const double p[3], double time, double velocity[3]);

/* Writes the drag on the links first_geom..last_geom to qfrc_applied of the joints that carry them, which is what
 * xfrc_applied comes to, without its cost in every shorter substep; `loads` (links x 6) receives each link's force (N) and
 * moment about the world's origin (N m). Positions and velocities must be up to date, the links a chain of bodies. What
 * lies in the sheath feels nothing. */
void blood_drag(const Drag* drag, const mjModel* m, mjData* d, int first_geom, int last_geom, const Vessel* v,
                double* loads);

#endif
