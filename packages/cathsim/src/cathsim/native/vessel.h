/* Vessels known to the native code: a signed-distance grid each, and the introducer sheath behind the entry. */
#ifndef CATHSIM_VESSEL_H_
#define CATHSIM_VESSEL_H_

#include <mujoco/mujoco.h>

#include "lattice.h"

/* geom_user of a vessel's geoms: this mark, the vessel's number here, and the part that the geom stands for. */
#define CATHSIM_MAGIC 1129469011.0
enum { VESSEL_LUMEN = 0, VESSEL_SHEATH = 1 };

typedef struct {
  Lattice distance;      /* signed distance, m, positive inside the lumen; the caller owns its values */
  double origin[3];      /* world position of node (0, 0, 0), m */
  double spacing;        /* m */
  double inverse;        /* 1 / spacing */
  double entry[3];       /* where the sheath opens into the vessel, m */
  double direction[3];   /* unit vector into the vessel */
  double sheath_radius;  /* inner radius, m; 0: no sheath */
  double sheath_flare;   /* by how much the bore is wider at its mouth, m */
  double sheath_overlap; /* how far the sheath's bore reaches past `entry`, m */
  int sheath_amid;       /* whether the sheath lies amid the lumen: its bore holds what is in it */
} Vessel;

/* The vessel that a geom stands for, or NULL; `part` may be NULL. */
const Vessel* vessel_of_geom(const mjModel* m, int geom, int* part);

/* A vessel that breathing moves: the model's user data are the displacement (m) of the lumen and its velocity (m/s). */
enum { VESSEL_DISPLACEMENT = 0, VESSEL_VELOCITY = 3, VESSEL_MOTION = 6 };

/* The vessel where it lies at the moment, in `moved` if it moves; its sheath never does. */
const Vessel* vessel_at_moment(const Vessel* v, const mjModel* m, const mjData* d, Vessel* moved);

/* Signed distance (m) at p, linear interpolation: cheap, for rejecting what is far from the wall. */
double vessel_distance(const Vessel* v, const double p[3]);

/* Signed distance (m) and its gradient at p, quadratic B-spline: the gradient is continuous. */
double vessel_distance_gradient(const Vessel* v, const double p[3], double gradient[3]);

/* Coordinate of p along the sheath's axis, m: negative inside the sheath. */
double vessel_sheath_coordinate(const Vessel* v, const double p[3]);

/* Whether the sheath matters to a link of a half length (m) about p: there is one, and the link does not lie far beside
 * it, where the vessel has turned back. */
int vessel_sheathed(const Vessel* v, const double p[3], double half);

/* Whether p, near a sheath, lies in it: behind its end, and amid the lumen within its bore. */
int vessel_in_sheath(const Vessel* v, const double p[3]);

#endif
