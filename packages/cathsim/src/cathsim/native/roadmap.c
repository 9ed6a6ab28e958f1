/* What a roadmap shows at a place in a vessel: the way down a distance field, and how far the wall is. */
#include <math.h>
#include <string.h>

#include "lattice.h"

typedef struct {
  double origin[3]; /* world position of node (0, 0, 0) of both lattices, m */
  double inverse;   /* 1 / spacing */
  Lattice wall;     /* signed distance to the wall, m, positive inside */
  Lattice remain;   /* distance along the lumen to the target, m */
} Roadmap;

static double sample(const Roadmap* r, const Lattice* values, const double p[3]) {
  int index[3];
  double t[3];
  for (int i = 0; i < 3; i++) {
    double u = (p[i] - r->origin[i]) * r->inverse;
    const double last = values->size[i] - 1.000001;
    u = u > 0 ? (u < last ? u : last) : 0; /* not a number gives 0 */
    index[i] = (int)u;
    t[i] = u - index[i];
  }
  return lattice_interpolate(values, index, t);
}

static void gradient(const Roadmap* r, const Lattice* values, const double p[3], double half, double g[3]) {
  for (int i = 0; i < 3; i++) {
    double a[3], b[3];
    memcpy(a, p, sizeof a);
    memcpy(b, p, sizeof b);
    a[i] -= half;
    b[i] += half;
    g[i] = (sample(r, values, b) - sample(r, values, a)) / (2 * half);
  }
}

/* Distance along the lumen from `start` to the target, m. Fills `path` (count x 3) with the points `step` apart on the
 * way there, each nudged off walls nearer than `clearance`; once at the target the last point is repeated. */
double cathsim_roadmap_path(const Roadmap* r, const double start[3], double step, double clearance, int count,
                            double* path) {
  const double spacing = 1 / r->inverse;
  double p[3];
  memcpy(p, start, sizeof p);
  for (int n = 0; n < count; n++) {
    double g[3], left = sample(r, &r->remain, p);
    if (left > 0.5 * step) {
      gradient(r, &r->remain, p, spacing, g);
      const double depth = sample(r, &r->wall, p);
      if (depth < clearance) {
        double inwards[3];
        gradient(r, &r->wall, p, spacing, inwards);
        const double push = 1 - depth / clearance;
        for (int i = 0; i < 3; i++) g[i] -= (push < 2 ? push : 2) * inwards[i];
      }
      const double norm = sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
      const double length = left < step ? left : step;
      if (norm > 1e-9)
        for (int i = 0; i < 3; i++) p[i] -= length * g[i] / norm;
    }
    memcpy(path + 3 * n, p, sizeof p);
  }
  return sample(r, &r->remain, start);
}

/* Distances (m, `limit` at most) from `start` to the wall along `count` unit directions (count x 3). */
void cathsim_roadmap_rays(const Roadmap* r, const double start[3], double limit, int count, const double* directions,
                          double* lengths) {
  const double least = 0.25 / r->inverse;
  for (int n = 0; n < count; n++) {
    double length = 0;
    while (length < limit) {
      double p[3];
      for (int i = 0; i < 3; i++) p[i] = start[i] + length * directions[3 * n + i];
      const double depth = sample(r, &r->wall, p);
      if (!(depth > 0)) break;
      length += depth > least ? depth : least;
    }
    lengths[n] = length < limit ? length : limit;
  }
}
