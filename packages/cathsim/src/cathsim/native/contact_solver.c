/* A wire has some 60 degrees of freedom and touches the wall in a few places, a long one that is buckled in forty. MuJoCo's
 * convex problem (Todorov 2014, "Convex and analytically-invertible dynamics with contacts and constraints in generalized
 * coordinates") is solved here in the space of the contacts instead of that of the joints:
 *
 *   least over y of  y'A y / 2 + s(z0 + A y),   A = J H^-1 J',   z0 = J a0 - aref,
 *
 * where H is the mass with the implicit damping and stiffness, which MuJoCo has factored, a0 the acceleration without
 * contacts and s MuJoCo's cost of the contacts, whose negative gradient are the forces. Newton's method makes the iterates of
 * the joints' space at the cost of the contacts' size; at the end y are the forces. */
#include "contact_solver.h"

#include "wide.h"

#include <math.h>
#include <string.h>

#define ITERATIONS 60
#define LINE_ITERATIONS 30
#define CONVERGED 1e-18 /* square of the forces' relative error, in the norm of A */
#define LINE_SHARE 1e-3 /* of the slope at the start that may be left after a line search */

/* A column of the factor G of the cost's second derivative G G': it has entries in at most three rows. */
typedef struct {
  int row, count;
  double value[3];
} Column;

typedef struct {
  const mjData* d;
  int rows, columns;
  double *A, *z, *force; /* rows x rows, and vectors of so many */
  Column column[SOLVER_ROWS];
} Problem;

int cathsim_solver_workspace(int nv) {
  return nv * (SOLVER_ROWS + 2) + 3 * SOLVER_ROWS * SOLVER_ROWS + 12 * SOLVER_ROWS;
}

int cathsim_solver_rows(void) { return SOLVER_ROWS; }

int contact_solvable(const mjModel* m, const mjData* d, int rows) {
  if (d->nefc > rows || m->opt.jacobian != mjJAC_SPARSE) return 0;
  for (int i = 0; i < m->nv; i++)
    if (m->M_rownnz[i] != i + 1) return 0; /* not one chain */
  for (int i = 0; i < d->nefc; i++) {
    if (d->efc_type[i] == mjCNSTR_CONTACT_FRICTIONLESS) continue;
    if (d->efc_type[i] != mjCNSTR_CONTACT_ELLIPTIC || d->contact[d->efc_id[i]].dim != 3) return 0;
    i += 2;
  }
  return 1;
}

/* y += factor x, n numbers */
static inline void add(double* restrict y, double factor, const double* restrict x, int n) {
  for (int i = 0; i < n; i++) y[i] += factor * x[i];
}

static inline double dot(const double* x, const double* y, int n) {
  double sum[4] = {0, 0, 0, 0};
  int i = 0;
  for (; i + 4 <= n; i += 4)
    for (int k = 0; k < 4; k++) sum[k] += x[i + k] * y[i + k];
  for (; i < n; i++) sum[0] += x[i] * y[i];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* y += first a + second b, n numbers: half of the reading and writing of two calls of `add`. */
static inline void add_two(double* restrict y, double first, const double* restrict a, double second,
                           const double* restrict b, int n) {
  for (int i = 0; i < n; i++) y[i] += first * a[i] + second * b[i];
}

/* Divides a row of a factor, from its diagonal on, by the square root of the latter; returns whether it is positive. */
static inline int pivot(double* row, int n) {
  if (!(row[0] > 0)) return 0;
  const double scale = 1 / sqrt(row[0]);
  for (int k = 0; k < n; k++) row[k] *= scale;
  return 1;
}

/* Factors a symmetric matrix, of which the upper triangle is given, as U'U in place; returns whether it is positive. */
WIDE static int factorise(double* a, int n) {
  for (int j = 0; j < n; j += 2) {
    double *row = a + j * n, *next = row + n;
    if (!pivot(row + j, n - j)) return 0;
    if (j + 1 == n) break;
    add(next + j + 1, -row[j + 1], row + j + 1, n - j - 1);
    if (!pivot(next + j + 1, n - j - 1)) return 0;
    for (int i = j + 2; i < n; i++) add_two(a + i * n + i, -row[i], row + i, -next[i], next + i, n - i);
  }
  return 1;
}

/* x = U'^-1 x */
static void solve_forward(const double* u, double* x, int n) {
  for (int j = 0; j < n; j += 2) {
    const double *row = u + j * n, *next = row + n;
    x[j] /= row[j];
    if (j + 1 == n) break;
    x[j + 1] = (x[j + 1] - x[j] * row[j + 1]) / next[j + 1];
    add_two(x + j + 2, -x[j], row + j + 2, -x[j + 1], next + j + 2, n - j - 2);
  }
}

/* x = U^-1 x */
static void solve_back(const double* u, double* x, int n) {
  for (int j = n - 1; j >= 0; j--) x[j] = (x[j] - dot(u + j * n + j + 1, x + j + 1, n - j - 1)) / u[j * n + j];
}

static void add_column(Problem* p, int row, int count, double first, double second, double third) {
  p->column[p->columns++] = (Column){row, count, {first, second, third}};
}

/* Cost of the contacts at z; sets the forces, and with `second` the factor of its second derivative. */
static double evaluate(Problem* p, const double* z, int second) {
  const mjData* d = p->d;
  double cost = 0;
  if (second) p->columns = 0;
  for (int i = 0; i < p->rows; i++) {
    const double stiffness = d->efc_D[i];
    if (d->efc_type[i] == mjCNSTR_CONTACT_FRICTIONLESS) {
      p->force[i] = z[i] < 0 ? -stiffness * z[i] : 0;
      cost -= 0.5 * p->force[i] * z[i];
      if (second && z[i] < 0) add_column(p, i, 1, sqrt(stiffness), 0, 0);
      continue;
    }
    const mjContact* c = d->contact + d->efc_id[i];
    const double mu = c->mu, *weight = c->friction;
    const double normal = z[i] * mu, u[2] = {z[i + 1] * weight[0], z[i + 2] * weight[1]};
    const double slide = sqrt(u[0] * u[0] + u[1] * u[1]);
    if (normal >= mu * slide) { /* no contact */
      for (int k = 0; k < 3; k++) p->force[i + k] = 0;
    } else if (mu * normal + slide <= 0) { /* it sticks */
      for (int k = 0; k < 3; k++) {
        p->force[i + k] = -d->efc_D[i + k] * z[i + k];
        cost -= 0.5 * p->force[i + k] * z[i + k];
        if (second) add_column(p, i + k, 1, sqrt(d->efc_D[i + k]), 0, 0);
      }
    } else { /* it slides */
      const double scale = stiffness / (mu * mu * (1 + mu * mu)), into = normal - mu * slide;
      const double along[2] = {u[0] / slide * weight[0], u[1] / slide * weight[1]};
      cost += 0.5 * scale * into * into;
      p->force[i] = -scale * into * mu;
      for (int k = 0; k < 2; k++) p->force[i + 1 + k] = scale * into * mu * along[k];
      if (second) {
        const double first = sqrt(scale) * mu, across = sqrt(-scale * into * mu / slide) / slide;
        add_column(p, i, 3, first, -first * along[0], -first * along[1]);
        add_column(p, i, 3, 0, -across * u[1] * weight[0], across * u[0] * weight[1]);
      }
    }
    i += 2;
  }
  return cost;
}

WIDE static void times(const double* a, const double* x, double* result, int n) {
  memset(result, 0, sizeof(double) * n);
  for (int i = 0; i < n; i++) add(result, x[i], a + i * n, n); /* symmetric */
}

/* G'x */
static void gather(const Problem* p, const double* x, double* result) {
  for (int a = 0; a < p->columns; a++) {
    const Column* c = p->column + a;
    result[a] = 0;
    for (int k = 0; k < c->count; k++) result[a] += c->value[k] * x[c->row + k];
  }
}

/* y += factor G x */
static void scatter(const Problem* p, double factor, const double* x, double* y) {
  for (int a = 0; a < p->columns; a++) {
    const Column* c = p->column + a;
    for (int k = 0; k < c->count; k++) y[c->row + k] += factor * c->value[k] * x[a];
  }
}

/* Newton's direction (I + S A)^-1 r with S = G G': r - G (I + G'A G)^-1 G' A r; `workspace`: two matrices, a vector. */
WIDE static int direction(const Problem* p, const double* r, const double* ar, double* result, double* workspace) {
  const int n = p->rows, columns = p->columns;
  double *ga = workspace, *inner = ga + columns * n, *right = inner + columns * columns;
  memcpy(result, r, sizeof(double) * n);
  gather(p, ar, right);
  for (int a = 0; a < columns; a++) {
    const Column* c = p->column + a;
    double* row = ga + a * n;
    memset(row, 0, sizeof(double) * n);
    for (int k = 0; k < c->count; k++) add(row, c->value[k], p->A + (c->row + k) * n, n);
    gather(p, row, inner + a * columns);
    inner[a * (columns + 1)] += 1;
  }
  if (!factorise(inner, columns)) return 0;
  solve_forward(inner, right, columns);
  solve_back(inner, right, columns);
  scatter(p, -1, right, result);
  return 1;
}

/* How far to go along a direction: where the slope vanishes, or nearly. Slope (at 0) and bend are of the quadratic part. */
static double line_search(Problem* p, const double* dz, double slope, double bend, double* z) {
  const int n = p->rows;
  double low = 0, high = INFINITY, t = 1, at_low = slope - dot(p->force, dz, n), at_high = 0;
  const double enough = LINE_SHARE * fabs(at_low);
  for (int i = 0; i < LINE_ITERATIONS; i++) {
    for (int k = 0; k < n; k++) z[k] = p->z[k] + t * dz[k];
    evaluate(p, z, 0);
    const double here = slope + t * bend - dot(p->force, dz, n);
    if (!(fabs(here) > enough)) break;
    if (here < 0) {
      low = t, at_low = here;
    } else {
      high = t, at_high = here;
    }
    if (isinf(high)) {
      t *= 2;
    } else { /* regula falsi, kept away from the ends */
      const double share = at_low / (at_low - at_high);
      t = low + (high - low) * (share < 0.05 ? 0.05 : share > 0.95 ? 0.95 : share);
    }
  }
  return t;
}

/* Rows x = D^-1/2 L'^-1 J', where L'DL is the mass with the implicit damping and stiffness, as MuJoCo has factored it; `scale`
 * is D^-1/2. Their products are A. */
WIDE static void project(const mjModel* m, const mjData* d, const double* scale, double* reached, double* A) {
  const int nv = m->nv, n = d->nefc;
  int count[SOLVER_ROWS]; /* what a contact does not move comes last */
  for (int i = 0; i < n; i++) {
    double* x = reached + i * nv;
    memset(x, 0, sizeof(double) * nv);
    count[i] = 0;
    for (int k = d->efc_J_rowadr[i]; k < d->efc_J_rowadr[i] + d->efc_J_rownnz[i]; k++) {
      x[d->efc_J_colind[k]] = d->efc_J[k];
      if (d->efc_J_colind[k] >= count[i]) count[i] = d->efc_J_colind[k] + 1;
    }
    int c = count[i] - 1;
    for (; c > 0; c -= 2) {
      const double *row = d->qH + m->M_rowadr[c], *next = d->qH + m->M_rowadr[c - 1];
      x[c - 1] -= x[c] * row[c - 1];
      add_two(x, -x[c], row, -x[c - 1], next, c - 1);
    }
    for (c = 0; c < count[i]; c++) x[c] *= scale[c];
    for (int j = 0; j <= i; j++)
      A[i * n + j] = A[j * n + i] = dot(x, reached + j * nv, count[i] < count[j] ? count[i] : count[j]);
  }
}

/* Begins where Newton's step from the last acceleration leads (z), or with no force, whichever costs less. */
static void begin(Problem* p, const double* z0, double* y, double* ay, double* workspace) {
  const int n = p->rows;
  double *r = workspace, *ar = r + n, *work = ar + n;
  double warm = INFINITY;
  evaluate(p, p->z, 1);
  for (int i = 0; i < n; i++) ar[i] = p->z[i] - z0[i];
  gather(p, ar, work);
  memcpy(r, p->force, sizeof(double) * n);
  scatter(p, 1, work, r);
  times(p->A, r, ar, n);
  if (direction(p, r, ar, y, work)) {
    times(p->A, y, ay, n);
    for (int i = 0; i < n; i++) p->z[i] = z0[i] + ay[i];
    warm = 0.5 * dot(y, ay, n) + evaluate(p, p->z, 0);
  }
  if (warm < evaluate(p, z0, 0)) return;
  memset(y, 0, sizeof(double) * n);
  memset(ay, 0, sizeof(double) * n);
  memcpy(p->z, z0, sizeof(double) * n);
}

WIDE void contact_solve(const mjModel* m, mjData* d, double* workspace) {
  const int nv = m->nv, n = d->nefc;
  double *reached = workspace, *acceleration = reached + nv * SOLVER_ROWS, *scale = acceleration + nv, *A = scale + nv;
  double *z0 = A + n * n, *z = z0 + n, *y = z + n, *ay = y + n, *r = ay + n, *ar = r + n, *dy = ar + n, *dz = dy + n;
  double *trial = dz + n, *work = trial + n;
  memset(d->qfrc_constraint, 0, sizeof(double) * nv);
  memcpy(d->qacc, d->qacc_smooth, sizeof(double) * nv);
  d->solver_niter[0] = 0;
  if (!n) return;
  for (int j = 0; j < nv; j++) scale[j] = sqrt(d->qHDiagInv[j]);
  project(m, d, scale, reached, A);
  for (int i = 0; i < n; i++) {
    z0[i] = z[i] = -d->efc_aref[i];
    for (int k = d->efc_J_rowadr[i]; k < d->efc_J_rowadr[i] + d->efc_J_rownnz[i]; k++) {
      z0[i] += d->efc_J[k] * d->qacc_smooth[d->efc_J_colind[k]];
      z[i] += d->efc_J[k] * d->qacc_warmstart[d->efc_J_colind[k]];
    }
  }
  Problem p = {.d = d, .rows = n, .A = A, .z = z, .force = d->efc_force};
  begin(&p, z0, y, ay, work);
  int iteration = 0;
  for (; iteration < ITERATIONS; iteration++) {
    evaluate(&p, z, 1);
    for (int i = 0; i < n; i++) r[i] = p.force[i] - y[i];
    times(A, r, ar, n);
    times(A, p.force, dz, n);
    if (!(dot(r, ar, n) > CONVERGED * dot(p.force, dz, n))) break;
    if (!direction(&p, r, ar, dy, work)) break;
    times(A, dy, dz, n);
    const double t = line_search(&p, dz, dot(y, dz, n), dot(dy, dz, n), trial);
    add(y, t, dy, n);
    add(ay, t, dz, n);
    for (int i = 0; i < n; i++) z[i] = z0[i] + ay[i];
  }
  d->solver_niter[0] = iteration;
  memset(acceleration, 0, sizeof(double) * nv);
  for (int i = 0; i < n; i++) add(acceleration, p.force[i], reached + i * nv, nv);
  for (int j = 0; j < nv; j++) {
    acceleration[j] = scale[j] * acceleration[j] - dot(d->qH + m->M_rowadr[j], acceleration, j);
    d->qacc[j] += acceleration[j];
  }
  for (int i = 0; i < n; i++)
    for (int k = d->efc_J_rowadr[i]; k < d->efc_J_rowadr[i] + d->efc_J_rownnz[i]; k++)
      d->qfrc_constraint[d->efc_J_colind[k]] += d->efc_J[k] * p.force[i];
}
