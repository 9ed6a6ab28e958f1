/* Capsule against vessel: the function that stands in MuJoCo's collision table for (capsule, box). */
#include <math.h>
#include <string.h>

#include "vessel.h"

#define NSAMPLES 5 /* along a link, both ends included */
#define MAX_CONTACTS 2 /* a link; MuJoCo allows no more for this pair of types without harm to speed */

static mjfCollision original; /* MuJoCo's own function, for every box that is not a vessel */

/* A candidate contact on the capsule's axis. */
typedef struct {
  double point[3], gradient[3], distance;
} Candidate;

static int emit(mjPreContact* contact, const Candidate* c, double radius) {
  double norm = sqrt(c->gradient[0] * c->gradient[0] + c->gradient[1] * c->gradient[1] + c->gradient[2] * c->gradient[2]);
  /* on a medial axis, or far outside where the grid is clamped, there is no direction to push */
  if (!(norm > 1e-6)) return 0;
  contact->dist = c->distance - radius;
  double reach = radius + 0.5 * contact->dist;
  for (int i = 0; i < 3; i++) {
    contact->normal[i] = -c->gradient[i] / norm; /* from the wire to the wall */
    contact->pos[i] = c->point[i] + contact->normal[i] * reach;
    contact->tangent[i] = 0;
  }
  return 1;
}

static int capsule_vessel(const mjModel* m, mjData* d, mjPreContact* con, int g1, int g2, mjtNum margin) {
  int part;
  const Vessel* v = vessel_of_geom(m, g2, &part);
  if (!v) return original(m, d, con, g1, g2, margin);

  const double radius = m->geom_size[3 * g1], half = m->geom_size[3 * g1 + 1];
  const double* centre = d->geom_xpos + 3 * g1;
  const double* frame = d->geom_xmat + 9 * g1;
  const double axis[3] = {frame[2], frame[5], frame[8]};
  const double limit = radius + margin, reach = limit + 0.1 * v->spacing;

  const int sheathed = v->sheath_radius > 0;
  const double sheath_centre = sheathed ? vessel_sheath_coordinate(v, centre) : 1;
  if (sheathed && (part == VESSEL_SHEATH ? sheath_centre > half : sheath_centre < -half)) return 0;
  const double sheath_slope =
      axis[0] * v->direction[0] + axis[1] * v->direction[1] + axis[2] * v->direction[2];

  /* |distance(a) - distance(b)| <= |a - b|: one sample at the centre clears most links in a wide vessel */
  if (vessel_distance(v, centre) > reach + half) return 0;

  double distance[NSAMPLES];
  for (int i = 0; i < NSAMPLES; i++) {
    const double along = half * (2.0 * i / (NSAMPLES - 1) - 1);
    const double p[3] = {centre[0] + along * axis[0], centre[1] + along * axis[1], centre[2] + along * axis[2]};
    distance[i] = vessel_distance(v, p);
  }

  /* The two deepest local minima; the proximal end is left to the link before, whose distal end it is. */
  int first = -1, second = -1;
  for (int i = 1; i < NSAMPLES; i++) {
    if (distance[i] > reach || distance[i - 1] < distance[i] ||
        (i + 1 < NSAMPLES && distance[i + 1] <= distance[i]))
      continue;
    /* each part of the vessel has the contacts on its side of the entry */
    const double along = half * (2.0 * i / (NSAMPLES - 1) - 1);
    if (sheathed && (sheath_centre + along * sheath_slope < 0) != (part == VESSEL_SHEATH)) continue;
    if (first < 0 || distance[i] < distance[first]) {
      second = first;
      first = i;
    } else if (second < 0 || distance[i] < distance[second]) {
      second = i;
    }
  }

  int count = 0;
  const int chosen[MAX_CONTACTS] = {first, second};
  for (int j = 0; j < MAX_CONTACTS && chosen[j] >= 0; j++) {
    const double along = half * (2.0 * chosen[j] / (NSAMPLES - 1) - 1);
    Candidate c;
    for (int k = 0; k < 3; k++) c.point[k] = centre[k] + along * axis[k];
    c.distance = vessel_distance_gradient(v, c.point, c.gradient);
    if (c.distance < limit) count += emit(con + count, &c, radius);
  }
  return count;
}

/* Puts the function into MuJoCo's table (its address comes from the running library); safe to call again. */
void cathsim_contact_install(mjfCollision (*table)[mjNGEOMTYPES]) {
  mjfCollision* slot = &table[mjGEOM_CAPSULE][mjGEOM_BOX];
  if (*slot == capsule_vessel) return;
  original = *slot;
  *slot = capsule_vessel;
}
