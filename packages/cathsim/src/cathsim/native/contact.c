/* Capsule against vessel: the function that stands in MuJoCo's collision table for (capsule, box). */
#include <math.h>
#include <string.h>

#include "vessel.h"

#define NSAMPLES 5 /* along a link, both ends included */
#define MAX_CONTACTS 2 /* a link: more slow the solver down and keep the wire no further out of the wall */

static mjfCollision original; /* MuJoCo's own function, for every box that is not a vessel */

/* Where along the link (centre, half length, axis) a sample lies. */
static void sample_point(const double centre[3], const double axis[3], double half, int sample, double p[3]) {
  const double along = half * (2.0 * sample / (NSAMPLES - 1) - 1);
  for (int k = 0; k < 3; k++) p[k] = centre[k] + along * axis[k];
}

/* The contact of the dip in `distance` around sample `lowest`. A link that has cut into a thin ridge of the wall, such
 * as the carina between two branches, finds opposite gradients on the ridge's two sides: their mean over the samples in
 * the wall points out of the ridge, where the gradient of the deepest one alone would push along the link and let the
 * ridge be cut deeper. Samples count with their depth and by how much their gradient turns away from the deepest one's,
 * so that on a smooth wall that one alone decides. */
static int emit(mjPreContact* contact, const Vessel* v, const double centre[3], const double axis[3], double half,
                double radius, double limit, const double distance[NSAMPLES], int lowest) {
  double point[3], gradient[3];
  sample_point(centre, axis, half, lowest, point);
  const double deepest = vessel_distance_gradient(v, point, gradient);
  if (!(deepest < limit)) return 0;
  if (deepest < radius) {
    const double lowest_gradient[3] = {gradient[0], gradient[1], gradient[2]};
    for (int k = 0; k < 3; k++) gradient[k] *= radius - deepest;
    for (int side = -1; side <= 1; side += 2) {
      for (int i = lowest + side; i >= 0 && i < NSAMPLES && distance[i] < radius; i += side) {
        double p[3], g[3];
        sample_point(centre, axis, half, i, p);
        vessel_distance_gradient(v, p, g);
        const double along =
            lowest_gradient[0] * g[0] + lowest_gradient[1] * g[1] + lowest_gradient[2] * g[2];
        const double weight = (radius - distance[i]) * 0.5 * (along < 1 ? 1 - along : 0);
        for (int k = 0; k < 3; k++) gradient[k] += weight * g[k];
      }
    }
  }
  const double norm =
      sqrt(gradient[0] * gradient[0] + gradient[1] * gradient[1] + gradient[2] * gradient[2]);
  /* on a medial axis, or far outside where the grid is clamped, there is no direction to push */
  if (!(norm > 1e-9)) return 0;
  contact->dist = deepest - radius;
  const double reach = radius + 0.5 * contact->dist;
  for (int k = 0; k < 3; k++) {
    contact->normal[k] = -gradient[k] / norm; /* from the wire to the wall */
    contact->pos[k] = point[k] + contact->normal[k] * reach;
    contact->tangent[k] = 0;
  }
  return 1;
}

static int capsule_vessel(const mjModel* m, mjData* d, mjPreContact* con, int g1, int g2, mjtNum margin) {
  int part;
  const Vessel* v = vessel_of_geom(m, g2, &part);
  if (!v) return original(m, d, con, g1, g2, margin);
  Vessel moved;
  v = vessel_at_moment(v, m, d, &moved);

  const double radius = m->geom_size[3 * g1], half = m->geom_size[3 * g1 + 1];
  const double* centre = d->geom_xpos + 3 * g1;
  const double* frame = d->geom_xmat + 9 * g1;
  const double axis[3] = {frame[2], frame[5], frame[8]};
  const double limit = radius + margin, reach = limit + 0.1 * v->spacing;

  const int sheathed = vessel_sheathed(v, centre, half);
  if (part == VESSEL_SHEATH && !sheathed) return 0;
  const double sheath_centre = sheathed ? vessel_sheath_coordinate(v, centre) : 1;
  if (sheathed && (part == VESSEL_SHEATH ? sheath_centre > half : sheath_centre < -half && vessel_in_sheath(v, centre)))
    return 0;
  const double sheath_slope =
      axis[0] * v->direction[0] + axis[1] * v->direction[1] + axis[2] * v->direction[2];

  /* |distance(a) - distance(b)| <= |a - b|: one sample at the centre clears most links in a wide vessel */
  if (vessel_distance(v, centre) > reach + half) return 0;

  double distance[NSAMPLES];
  for (int i = 0; i < NSAMPLES; i++) {
    double p[3];
    sample_point(centre, axis, half, i, p);
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
    int in_sheath = sheathed && sheath_centre + along * sheath_slope < 0;
    if (in_sheath && v->sheath_amid) {
      double p[3];
      sample_point(centre, axis, half, i, p);
      in_sheath = vessel_in_sheath(v, p);
    }
    if (in_sheath != (part == VESSEL_SHEATH)) continue;
    if (first < 0 || distance[i] < distance[first]) {
      second = first;
      first = i;
    } else if (second < 0 || distance[i] < distance[second]) {
      second = i;
    }
  }

  int count = 0;
  const int chosen[MAX_CONTACTS] = {first, second};
  for (int j = 0; j < MAX_CONTACTS && chosen[j] >= 0; j++)
    count += emit(con + count, v, centre, axis, half, radius, limit, distance, chosen[j]);
  return count;
}

/* Puts the function into MuJoCo's table (its address comes from the running library); safe to call again. */
void cathsim_contact_install(mjfCollision (*table)[mjNGEOMTYPES]) {
  mjfCollision* slot = &table[mjGEOM_CAPSULE][mjGEOM_BOX];
  if (*slot == capsule_vessel) return;
  original = *slot;
  *slot = capsule_vessel;
}
