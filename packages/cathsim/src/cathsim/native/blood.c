#include "blood.h"

#include <math.h>
#include <string.h>

#define MAX_ANCESTORS 64
#define MAX_PARTS 8

/* NaN gives `low`: a state that has become invalid must not turn into an index. */
static inline double clamp(double x, double low, double high) { return x > low ? (x < high ? x : high) : low; }

/* The two tables between which a moment lies. */
typedef struct {
  const double* now;
  const double* next;
  double t;
} Moment;

static Moment moment_of(const Blood* b, double time) {
  const double turns = b->start + b->frequency * time;
  const double phase = clamp((turns - floor(turns)) * b->phases, 0, b->phases - 1e-9);
  const int index = (int)phase;
  const size_t stride = (size_t)b->rows * b->columns;
  Moment moment = {b->table + index * stride, b->table + (index + 1) * stride, phase - index};
  return moment;
}

/* Every node around p offers the section it belongs to, evaluated at p itself, not at the node: inside a vessel all
 * agree, and from one vessel to the next the weights blend. */
static void velocity_at(const Blood* b, const Moment* moment, const double p[3], double velocity[3]) {
  int index[3];
  double t[3];
  velocity[0] = velocity[1] = velocity[2] = 0;
  for (int i = 0; i < 3; i++) {
    const double u = (p[i] - b->origin[i]) * b->inverse;
    if (!(u >= 0 && u < b->size[i] - 1)) return;
    index[i] = (int)u;
    t[i] = u - index[i];
  }
  const int sy = b->size[2], sx = b->size[1] * b->size[2];
  const int* base = b->nodes + (size_t)index[0] * sx + index[1] * sy + index[2];
  double total = 0, square = 0, row = 0, axis[3] = {0, 0, 0};
  for (int corner = 0; corner < 8; corner++) {
    const int i = corner >> 2, j = corner >> 1 & 1, k = corner & 1;
    const int node = base[i * sx + j * sy + k];
    if (node < 0) continue;
    const double w = (i ? t[0] : 1 - t[0]) * (j ? t[1] : 1 - t[1]) * (k ? t[2] : 1 - t[2]);
    const BloodSample* s = b->samples + node;
    const double x = p[0] - s->centre[0], y = p[1] - s->centre[1], z = p[2] - s->centre[2];
    const double ahead = x * s->along[0] + y * s->along[1] + z * s->along[2];
    const double wg = w * s->share;
    square += w * (x * x + y * y + z * z - ahead * ahead) * s->inverse_square;
    for (int n = 0; n < 3; n++) axis[n] += wg * s->along[n];
    row += w * s->row;
    total += w;
  }
  if (!(total > 1e-9)) return;
  square /= total;
  if (!(square < 1)) return;
  const double column = clamp(square, 0, 1) * (b->columns - 1), line = clamp(row / total, 0, b->rows - 1);
  const int c = column < b->columns - 2 ? (int)column : b->columns - 2;
  const int r = b->rows < 2 ? 0 : line < b->rows - 2 ? (int)line : b->rows - 2;
  const int down = b->rows < 2 ? 0 : b->columns;
  const double tc = column - c, tr = line - r;
  double value[2];
  for (int side = 0; side < 2; side++) {
    const double* q = (side ? moment->next : moment->now) + (size_t)r * b->columns + c;
    const double upper = q[0] + tc * (q[1] - q[0]), lower = q[down] + tc * (q[down + 1] - q[down]);
    value[side] = upper + tr * (lower - upper);
  }
  const double flow = (value[0] + moment->t * (value[1] - value[0])) / total;
  for (int n = 0; n < 3; n++) velocity[n] = flow * axis[n];
}

void blood_velocity(const Blood* b, const double p[3], double time, double velocity[3]) {
  const Moment moment = moment_of(b, time);
  velocity_at(b, &moment, p, velocity);
}

/* Velocities (m/s) at n points (n x 3, m), for use from outside. */
void cathsim_blood_velocities(const Blood* b, int n, const double* points, double time, double* velocities) {
  const Moment moment = moment_of(b, time);
  for (int i = 0; i < n; i++) velocity_at(b, &moment, points + 3 * i, velocities + 3 * i);
}

/* Motion of a rigid body: velocity of the point `at`, angular velocity. */
typedef struct {
  double at[3];
  double velocity[3];
  double turning[3];
} Motion;

static void point_velocity(const Motion* motion, const double p[3], double velocity[3]) {
  const double x = p[0] - motion->at[0], y = p[1] - motion->at[1], z = p[2] - motion->at[2];
  const double* w = motion->turning;
  velocity[0] = motion->velocity[0] + w[1] * z - w[2] * y;
  velocity[1] = motion->velocity[1] + w[2] * x - w[0] * z;
  velocity[2] = motion->velocity[2] + w[0] * y - w[1] * x;
}

/* From a parent's motion to that of its child, over the slides and hinges between them. */
static void pass_joints(Motion* motion, const mjModel* m, const mjData* d, int body) {
  for (int j = m->body_jntadr[body], last = j + m->body_jntnum[body]; j >= 0 && j < last; j++) {
    const double *axis = d->xaxis + 3 * j, rate = d->qvel[m->jnt_dofadr[j]];
    if (m->jnt_type[j] == mjJNT_SLIDE) {
      for (int k = 0; k < 3; k++) motion->velocity[k] += axis[k] * rate;
    } else if (m->jnt_type[j] == mjJNT_HINGE) {
      double velocity[3];
      point_velocity(motion, d->xanchor + 3 * j, velocity);
      memcpy(motion->at, d->xanchor + 3 * j, sizeof velocity);
      memcpy(motion->velocity, velocity, sizeof velocity);
      for (int k = 0; k < 3; k++) motion->turning[k] += axis[k] * rate;
    }
  }
}

/* Force (N/m) of blood that passes a cylinder with a relative velocity. `most`: coefficient at which the drag would
 * stop the link within a step; a larger one would throw it back. */
static void cylinder_force(const Drag* drag, const double axis[3], const double relative[3], double most,
                           double force[3]) {
  const double along = relative[0] * axis[0] + relative[1] * axis[1] + relative[2] * axis[2];
  double across[3], square = 0;
  for (int k = 0; k < 3; k++) {
    across[k] = relative[k] - along * axis[k];
    square += across[k] * across[k];
  }
  const double speed = sqrt(square), root = sqrt(speed);
  double normal = drag->across_viscous + drag->across_layer * root + drag->across_inertial * speed;
  double axial = drag->along_viscous + drag->along_layer * root;
  if (normal > most) normal = most;
  if (axial > most) axial = most;
  for (int k = 0; k < 3; k++) force[k] = normal * across[k] + axial * along * axis[k];
}

/* Force (N) and moment about the world's origin (N m) of the blood on one link. */
static void link_drag(const Drag* drag, const Moment* moment, const mjModel* m, const mjData* d, int geom,
                      const Motion* motion, const Vessel* v, double load[6]) {
  const double half = m->geom_size[3 * geom + 1], *centre = d->geom_xpos + 3 * geom, *frame = d->geom_xmat + 9 * geom;
  const double axis[3] = {frame[2], frame[5], frame[8]};
  for (int k = 0; k < 6; k++) load[k] = 0;
  const int sheathed = v && vessel_sheathed(v, centre, half);
  if (sheathed && vessel_sheath_coordinate(v, centre) < -half && vessel_in_sheath(v, centre)) return;
  const int wanted = (int)ceil(2 * half / drag->spacing - 1e-6);
  const int parts = wanted < 1 ? 1 : wanted < MAX_PARTS ? wanted : MAX_PARTS;
  const double part = 2 * half / parts;
  const double most = m->body_mass[m->geom_bodyid[geom]] / (2 * half * m->opt.timestep);
  for (int i = 0; i < parts; i++) {
    const double at = part * (i + 0.5) - half;
    double p[3], flow[3], moving[3], relative[3], force[3];
    for (int k = 0; k < 3; k++) p[k] = centre[k] + at * axis[k];
    if (sheathed && vessel_in_sheath(v, p)) continue;
    if (m->nuserdata >= VESSEL_MOTION) { /* the blood moves with its vessel */
      double in_vessel[3];
      for (int k = 0; k < 3; k++) in_vessel[k] = p[k] - d->userdata[VESSEL_DISPLACEMENT + k];
      velocity_at(drag->blood, moment, in_vessel, flow);
      for (int k = 0; k < 3; k++) flow[k] += d->userdata[VESSEL_VELOCITY + k];
    } else {
      velocity_at(drag->blood, moment, p, flow);
    }
    point_velocity(motion, p, moving);
    for (int k = 0; k < 3; k++) relative[k] = flow[k] - moving[k];
    cylinder_force(drag, axis, relative, most, force);
    for (int k = 0; k < 3; k++) load[k] += force[k] *= part;
    load[3] += p[1] * force[2] - p[2] * force[1];
    load[4] += p[2] * force[0] - p[0] * force[2];
    load[5] += p[0] * force[1] - p[1] * force[0];
  }
}

/* What a load on a body and all beyond it means for the body's slides and hinges. */
static void load_joints(const double load[6], const mjModel* m, mjData* d, int body) {
  for (int j = m->body_jntadr[body], last = j + m->body_jntnum[body]; j >= 0 && j < last; j++) {
    const double *axis = d->xaxis + 3 * j, *anchor = d->xanchor + 3 * j;
    double moment[3];
    if (m->jnt_type[j] == mjJNT_SLIDE) {
      memcpy(moment, load, sizeof moment);
    } else if (m->jnt_type[j] == mjJNT_HINGE) {
      moment[0] = load[3] - anchor[1] * load[2] + anchor[2] * load[1];
      moment[1] = load[4] - anchor[2] * load[0] + anchor[0] * load[2];
      moment[2] = load[5] - anchor[0] * load[1] + anchor[1] * load[0];
    } else {
      continue;
    }
    d->qfrc_applied[m->jnt_dofadr[j]] = axis[0] * moment[0] + axis[1] * moment[1] + axis[2] * moment[2];
  }
}

void blood_drag(const Drag* drag, const mjModel* m, mjData* d, int first_geom, int last_geom, const Vessel* v,
                double* loads) {
  const Moment moment = moment_of(drag->blood, d->time);
  Motion motion = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  int ancestors[MAX_ANCESTORS], count = 0;
  for (int body = m->body_parentid[m->geom_bodyid[first_geom]]; body > 0 && count < MAX_ANCESTORS;
       body = m->body_parentid[body])
    ancestors[count++] = body;
  for (int i = count - 1; i >= 0; i--) pass_joints(&motion, m, d, ancestors[i]);
  for (int geom = first_geom; geom <= last_geom; geom++) {
    pass_joints(&motion, m, d, m->geom_bodyid[geom]);
    link_drag(drag, &moment, m, d, geom, &motion, v, loads + 6 * (geom - first_geom));
  }
  double total[6] = {0, 0, 0, 0, 0, 0};
  for (int geom = last_geom; geom >= first_geom; geom--) {
    for (int k = 0; k < 6; k++) total[k] += loads[6 * (geom - first_geom) + k];
    load_joints(total, m, d, m->geom_bodyid[geom]);
  }
  for (int i = 0; i < count; i++) load_joints(total, m, d, ancestors[i]);
}

/* One drag evaluation, for checks from outside. */
void cathsim_blood_cylinder(const Drag* drag, const double axis[3], const double relative[3], double most,
                            double force[3]) {
  cylinder_force(drag, axis, relative, most, force);
}
