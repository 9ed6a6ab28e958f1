#include "vessel.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#define MAX_VESSELS 4096
/* Further behind the sheath's end than an open end of the vessel, and further from its bore than a link is long, a
 * place lies in the vessel, not in the sheath: m. */
#define BESIDE_BEHIND 3e-3
#define BESIDE_APART 8e-3
#define FLARE_LENGTH 10e-3 /* of the part of the bore that widens to the mouth: m */
#define BORE_MARGIN 1e-3 /* amid the lumen, a wire so far out of the bore is still held by it: m */

/* Slots are written once under the lock and read without it: a geom only carries a number that registration returned. */
static Vessel* vessels[MAX_VESSELS];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

/* Returns the vessel's number, -1 when the table is full or memory is short. The grid must outlive the registration. */
int cathsim_vessel_register(const Lattice* distance, const double origin[3], double spacing, const double entry[3],
                            const double direction[3], double sheath_radius, double sheath_flare, double sheath_overlap,
                            int sheath_amid) {
  Vessel* v = malloc(sizeof(Vessel));
  if (!v) return -1;
  v->distance = *distance;
  memcpy(v->origin, origin, sizeof v->origin);
  v->spacing = spacing;
  v->inverse = 1.0 / spacing;
  memcpy(v->entry, entry, sizeof v->entry);
  memcpy(v->direction, direction, sizeof v->direction);
  v->sheath_radius = sheath_radius;
  v->sheath_flare = sheath_flare;
  v->sheath_overlap = sheath_overlap;
  v->sheath_amid = sheath_amid;

  int number = -1;
  pthread_mutex_lock(&lock);
  for (int i = 0; i < MAX_VESSELS; i++) {
    if (!vessels[i]) {
      __atomic_store_n(&vessels[i], v, __ATOMIC_RELEASE);
      number = i;
      break;
    }
  }
  pthread_mutex_unlock(&lock);
  if (number < 0) free(v);
  return number;
}

/* The caller guarantees that no model with this number is stepped any more. */
void cathsim_vessel_release(int number) {
  if (number < 0 || number >= MAX_VESSELS) return;
  pthread_mutex_lock(&lock);
  free(vessels[number]);
  __atomic_store_n(&vessels[number], NULL, __ATOMIC_RELEASE);
  pthread_mutex_unlock(&lock);
}

const Vessel* vessel_of_geom(const mjModel* m, int geom, int* part) {
  if (m->nuser_geom < 3) return NULL;
  const mjtNum* user = m->geom_user + (size_t)geom * m->nuser_geom;
  if (user[0] != CATHSIM_MAGIC) return NULL;
  int number = (int)user[1];
  if (part) *part = (int)user[2];
  if (number < 0 || number >= MAX_VESSELS) return NULL;
  return __atomic_load_n(&vessels[number], __ATOMIC_ACQUIRE);
}

const Vessel* vessel_at_moment(const Vessel* v, const mjModel* m, const mjData* d, Vessel* moved) {
  if (!v || m->nuserdata < VESSEL_MOTION) return v;
  *moved = *v;
  for (int k = 0; k < 3; k++) moved->origin[k] += d->userdata[VESSEL_DISPLACEMENT + k];
  return moved;
}

double vessel_sheath_coordinate(const Vessel* v, const double p[3]) {
  return (p[0] - v->entry[0]) * v->direction[0] + (p[1] - v->entry[1]) * v->direction[1] +
         (p[2] - v->entry[2]) * v->direction[2];
}

/* By how much the bore is wider at a coordinate s (m) along the sheath's axis than far behind its mouth, m, and the slope
 * with which it widens: like a parabola, so that a bent link is led into it and not caught by an edge. */
static inline double widening(const Vessel* v, double s, double* slope) {
  const double share = v->sheath_flare > 0 ? fmin(fmax(1 + s / FLARE_LENGTH, 0), 1) : 0;
  *slope = s < 0 ? 2 * v->sheath_flare * share / FLARE_LENGTH : 0;
  return v->sheath_flare * share * share;
}

/* Whether p is further from the sheath's axis than its bore and a margin (m). */
static int outside_bore(const Vessel* v, const double p[3], double margin) {
  double slope;
  const double s = vessel_sheath_coordinate(v, p), reach = v->sheath_radius + widening(v, s, &slope) + margin;
  double rho2 = 0;
  for (int i = 0; i < 3; i++) {
    const double radial = p[i] - v->entry[i] - s * v->direction[i];
    rho2 += radial * radial;
  }
  return rho2 > reach * reach;
}

int vessel_sheathed(const Vessel* v, const double p[3], double half) {
  if (v->sheath_radius <= 0) return 0;
  if (v->sheath_amid) return !outside_bore(v, p, BORE_MARGIN + half);
  return vessel_sheath_coordinate(v, p) > -BESIDE_BEHIND || !outside_bore(v, p, BESIDE_APART);
}

int vessel_in_sheath(const Vessel* v, const double p[3]) {
  return vessel_sheath_coordinate(v, p) < 0 && !(v->sheath_amid && outside_bore(v, p, BORE_MARGIN));
}

/* Distance to the wall of the sheath's bore; -HUGE_VAL where the sheath cannot matter. */
static double sheath_distance(const Vessel* v, const double p[3], double gradient[3]) {
  if (v->sheath_radius <= 0) return -HUGE_VAL;
  double s = vessel_sheath_coordinate(v, p);
  if (s > v->sheath_overlap) return -HUGE_VAL;
  double radial[3], rho2 = 0;
  for (int i = 0; i < 3; i++) {
    radial[i] = p[i] - v->entry[i] - s * v->direction[i];
    rho2 += radial[i] * radial[i];
  }
  double rho = sqrt(rho2), distance = v->sheath_radius - rho;
  if (gradient) {
    double scale = rho > 1e-9 ? -1 / rho : 0;
    for (int i = 0; i < 3; i++) gradient[i] = radial[i] * scale;
  }
  double slope;
  const double wider = widening(v, s, &slope);
  if (wider <= 0) return distance;
  const double scale = 1 / sqrt(1 + slope * slope);
  if (gradient)
    for (int i = 0; i < 3; i++) gradient[i] = scale * (gradient[i] + slope * v->direction[i]);
  return scale * (distance + wider);
}

/* NaN gives `low`: a state that has become invalid must not turn into an index. */
static inline double clamp(double x, double low, double high) { return x > low ? (x < high ? x : high) : low; }

double vessel_distance(const Vessel* v, const double p[3]) {
  if (v->sheath_amid && vessel_in_sheath(v, p)) return sheath_distance(v, p, NULL);
  int index[3];
  double t[3];
  for (int i = 0; i < 3; i++) {
    double u = clamp((p[i] - v->origin[i]) * v->inverse, 0, v->distance.size[i] - 1.000001);
    index[i] = (int)u;
    t[i] = u - index[i];
  }
  const double grid = lattice_interpolate(&v->distance, index, t);
  double sheath = sheath_distance(v, p, NULL);
  return grid > sheath ? grid : sheath;
}

double vessel_distance_gradient(const Vessel* v, const double p[3], double gradient[3]) {
  if (v->sheath_amid && vessel_in_sheath(v, p)) return sheath_distance(v, p, gradient);
  int index[3];
  double w[3][3], dw[3][3];
  for (int i = 0; i < 3; i++) {
    double u = clamp((p[i] - v->origin[i]) * v->inverse, 1, v->distance.size[i] - 2.000001);
    int nearest = (int)(u + 0.5);
    double t = u - nearest;
    index[i] = nearest;
    w[i][0] = 0.5 * (0.5 - t) * (0.5 - t);
    w[i][1] = 0.75 - t * t;
    w[i][2] = 0.5 * (0.5 + t) * (0.5 + t);
    dw[i][0] = t - 0.5;
    dw[i][1] = -2 * t;
    dw[i][2] = t + 0.5;
  }
  const float* base = lattice_node(&v->distance, index[0], index[1], index[2]) - NODE_X - NODE_Y - NODE_Z;
  double value = 0, gx = 0, gy = 0, gz = 0;
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) {
      const float* c = base + i * NODE_X + j * NODE_Y;
      double line = w[2][0] * c[0] + w[2][1] * c[1] + w[2][2] * c[2];
      double slope = dw[2][0] * c[0] + dw[2][1] * c[1] + dw[2][2] * c[2];
      double wij = w[0][i] * w[1][j];
      value += wij * line;
      gx += dw[0][i] * w[1][j] * line;
      gy += w[0][i] * dw[1][j] * line;
      gz += wij * slope;
    }
  }
  gradient[0] = gx * v->inverse;
  gradient[1] = gy * v->inverse;
  gradient[2] = gz * v->inverse;

  double sheath_gradient[3];
  double sheath = sheath_distance(v, p, sheath_gradient);
  if (sheath > value) {
    memcpy(gradient, sheath_gradient, sizeof sheath_gradient);
    return sheath;
  }
  return value;
}

/* Distances (m) of n points (n x 3, m); for checks from outside. */
void cathsim_vessel_distances(int number, int n, const double* points, double* distances, double* gradients) {
  const Vessel* v = vessels[number];
  for (int i = 0; i < n; i++) {
    double g[3];
    distances[i] = vessel_distance_gradient(v, points + 3 * i, g);
    if (gradients) memcpy(gradients + 3 * i, g, sizeof g);
  }
}
