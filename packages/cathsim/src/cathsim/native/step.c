#include "step.h"

#include "contact_solver.h"

#include <math.h>
#include <string.h>

/* Contact forces on the wire: points (m) and forces (N), world frame; returns how many, at most `capacity`. */
int cathsim_contact_forces(const Simulation* s, const Engine* engine, int capacity, double* points, double* forces) {
  const mjData* d = s->data;
  int count = 0;
  for (int i = 0; i < d->ncon && count < capacity; i++) {
    const mjContact* c = d->contact + i;
    if (c->geom[1] < s->vessel_geom || c->geom[1] > s->vessel_geom + s->hulls || c->efc_address < 0) continue;
    mjtNum local[6];
    engine->contact_force(s->model, d, i, local);
    for (int k = 0; k < 3; k++) {
      points[3 * count + k] = c->pos[k];
      /* MuJoCo's force acts on the second geom, the wall; the wire feels the opposite */
      forces[3 * count + k] = -(c->frame[k] * local[0] + c->frame[3 + k] * local[1] + c->frame[6 + k] * local[2]);
    }
    count++;
  }
  return count;
}

/* Deepest penetration (m) of the wire's surface at the current geom poses, `samples` points a capsule; what lies in
 * the sheath is left out. */
double cathsim_penetration(const Simulation* s, int samples) {
  const mjModel* m = s->model;
  const mjData* d = s->data;
  Vessel moved;
  const Vessel* v = vessel_at_moment(vessel_of_geom(m, s->vessel_geom, NULL), m, d, &moved);
  double deepest = 0;
  if (!v) return 0;
  for (int g = s->first_geom; g <= s->last_geom; g++) {
    const double radius = m->geom_size[3 * g], half = m->geom_size[3 * g + 1];
    const double *centre = d->geom_xpos + 3 * g, *frame = d->geom_xmat + 9 * g;
    const int sheathed = vessel_sheathed(v, centre, half);
    if (sheathed && vessel_sheath_coordinate(v, centre) < -half && vessel_in_sheath(v, centre)) continue;
    if (vessel_distance(v, centre) > radius + half - deepest) continue;
    for (int i = 0; i < samples; i++) {
      const double at = half * (2.0 * (i + 1) / samples - 1);
      const double p[3] = {centre[0] + at * frame[2], centre[1] + at * frame[5], centre[2] + at * frame[8]};
      if (sheathed && vessel_in_sheath(v, p)) continue;
      const double depth = radius - vessel_distance(v, p);
      if (depth > deepest) deepest = depth;
    }
  }
  return deepest;
}

/* Where the contacts of the largest resultant force are kept, and memory for those of the moment. */
typedef struct {
  int capacity;
  double *points, *forces;         /* capacity x 3 each */
  double *now_points, *now_forces; /* likewise */
  double *kept_points, *kept_forces; /* likewise: of before a substep that may be taken back */
  StepSummary* summary;
} Account;

/* Adds the sheath's contact forces on the wire, times `share`, to `sum`: those of the world's geoms after the wall's. */
static void add_sheath_forces(const Simulation* s, const Engine* engine, double share, double sum[3]) {
  const mjData* d = s->data;
  for (int i = 0; i < d->ncon; i++) {
    const mjContact* c = d->contact + i;
    if (c->efc_address < 0 || c->geom[1] <= s->vessel_geom + s->hulls || s->model->geom_bodyid[c->geom[1]]) continue;
    mjtNum local[6];
    engine->contact_force(s->model, d, i, local);
    for (int k = 0; k < 3; k++)
      sum[k] -= share * (c->frame[k] * local[0] + c->frame[3 + k] * local[1] + c->frame[6 + k] * local[2]);
  }
}

/* Enters the contact forces of the step just made, which lasted `share` of the control step. */
static void enter_forces(const Simulation* s, const Engine* engine, const Account* a, double share) {
  StepSummary* summary = a->summary;
  const int count = cathsim_contact_forces(s, engine, a->capacity, a->now_points, a->now_forces);
  double f[3] = {0, 0, 0};
  for (int c = 0; c < count; c++) {
    const double* one = a->now_forces + 3 * c;
    for (int k = 0; k < 3; k++) f[k] += one[k];
    const double magnitude = sqrt(one[0] * one[0] + one[1] * one[1] + one[2] * one[2]);
    summary->magnitude_sum += magnitude * share;
    if (magnitude > summary->contact_max) summary->contact_max = magnitude;
  }
  for (int k = 0; k < 3; k++) summary->mean_force[k] += f[k] * share;
  add_sheath_forces(s, engine, share, summary->sheath_force);
  const double norm = sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]);
  summary->force_mean += norm * share;
  if (norm > summary->force_max) {
    summary->force_max = norm;
    memcpy(summary->force, f, sizeof f);
    summary->contacts = count;
    memcpy(a->points, a->now_points, sizeof(double) * 3 * count);
    memcpy(a->forces, a->now_forces, sizeof(double) * 3 * count);
  }
}

static int warnings(const mjData* d) {
  return d->warning[mjWARN_BADQPOS].number + d->warning[mjWARN_BADQVEL].number + d->warning[mjWARN_BADQACC].number;
}

/* Displaces the vessel to where breathing brings it by the end of the step that comes: (1 - cos) / 2 of the way. */
static void move_vessel(const Simulation* s, double timestep) {
  const double phase = s->breath_rate * (s->data->time + timestep);
  double* motion = s->data->userdata;
  for (int k = 0; k < 3; k++) {
    motion[VESSEL_DISPLACEMENT + k] = 0.5 * s->breath[k] * (1 - cos(phase));
    motion[VESSEL_VELOCITY + k] = 0.5 * s->breath[k] * s->breath_rate * sin(phase);
  }
}

/* Sets the blood's drag for the next substep; where that is repeated in shorter ones, it keeps the same. Positions are
 * those of the last substep's end, unless the state was set from outside or nothing has computed them since. */
static void apply_drag(Simulation* s, const Engine* engine, int first) {
  if (s->breath_rate > 0) move_vessel(s, 0); /* of this moment: a restored state has none yet */
  if (first || s->refinement <= 1) engine->kinematics(s->model, s->data);
  const Vessel* v = vessel_of_geom(s->model, s->vessel_geom, NULL);
  blood_drag(s->drag, s->model, s->data, s->first_geom, s->last_geom, v, s->loads);
}

/* State and account of before a substep. */
typedef struct {
  double time;
  mjWarningStat warning[mjNWARNING];
  StepSummary summary;
} Before;

static void keep_state(const Simulation* s, Before* before) {
  const mjData* d = s->data;
  const int nq = s->model->nq, nv = s->model->nv;
  memcpy(s->saved, d->qpos, sizeof(double) * nq);
  memcpy(s->saved + nq, d->qvel, sizeof(double) * nv);
  memcpy(s->saved + nq + nv, d->qacc_warmstart, sizeof(double) * nv);
  before->time = d->time;
  memcpy(before->warning, d->warning, sizeof before->warning);
}

static void keep_account(const Account* a, Before* before) {
  const int count = 3 * a->summary->contacts;
  before->summary = *a->summary;
  memcpy(a->kept_points, a->points, sizeof(double) * count);
  memcpy(a->kept_forces, a->forces, sizeof(double) * count);
}

static void take_back_state(const Simulation* s, const Before* before) {
  mjData* d = s->data;
  const int nq = s->model->nq, nv = s->model->nv;
  memcpy(d->qpos, s->saved, sizeof(double) * nq);
  memcpy(d->qvel, s->saved + nq, sizeof(double) * nv);
  memcpy(d->qacc_warmstart, s->saved + nq + nv, sizeof(double) * nv);
  d->time = before->time;
  memcpy(d->warning, before->warning, sizeof before->warning);
}

static void take_back_account(const Account* a, const Before* before) {
  const int count = 3 * before->summary.contacts;
  *a->summary = before->summary;
  memcpy(a->points, a->kept_points, sizeof(double) * count);
  memcpy(a->forces, a->kept_forces, sizeof(double) * count);
}

/* Tells the contacts with the wall how fast that moves along itself, for its friction. */
static void move_walls(const Simulation* s) {
  mjData* d = s->data;
  const double* velocity = d->userdata + VESSEL_VELOCITY;
  for (int i = 0; i < d->ncon; i++) {
    mjContact* c = d->contact + i;
    if (c->geom[1] < s->vessel_geom || c->geom[1] > s->vessel_geom + s->hulls) continue;
    for (int k = 0; k < 2; k++) {
      const double* tangent = c->frame + 3 * (k + 1);
      c->surfacevel[k] = tangent[0] * velocity[0] + tangent[1] * velocity[1] + tangent[2] * velocity[2];
    }
  }
}

/* The second half of MuJoCo's step, with the contacts solved here where they are few. */
static void finish_step(const Simulation* s, const Engine* engine, const mjModel* model) {
  mjData* d = s->data;
  if (s->solver_rows < 1 || !contact_solvable(model, d, s->solver_rows)) {
    engine->second_half(model, d);
    return;
  }
  /* everything up to the acceleration without contacts, and as little as can be of what comes after it; one iteration is
   * enough for that acceleration, none is not */
  mjModel unsolved = *model;
  unsolved.opt.solver = mjSOL_CG;
  unsolved.opt.iterations = 1;
  unsolved.opt.tolerance = 1e30;
  unsolved.opt.disableflags |= mjDSBL_WARMSTART;
  engine->forward(&unsolved, d, mjSTAGE_VEL, 1);
  contact_solve(model, d, s->workspace);
  engine->check_acceleration(model, d);
  const double h = model->opt.timestep;
  for (int i = 0; i < model->nv; i++) d->qvel[i] += h * d->qacc[i];
  engine->integrate(model, d->qpos, d->qvel, h);
  d->time += h;
  memcpy(d->qacc_warmstart, d->qacc, sizeof(double) * model->nv);
}

/* One step of `model`. In a compliant wall every contact is a spring of `wall_stiffness`, without damping, integrated
 * implicitly. MuJoCo's regularisation of a contact is (1 - d) / d times the diagonal A of the constraint's inverse
 * inertia, which it knows only once it has solved: the state is solved twice, and d set between. Its discrete integrator
 * divides the reference acceleration k r + b v by 1 + h b + h^2 k, which is 3 with b = 1 / h and k = 1 / h^2: so the
 * regularisation must be 1 / (3 h^2 K). */
static void step_engine(const Simulation* s, const Engine* engine, const mjModel* model) {
  mjData* d = s->data;
  const double h = model->opt.timestep;
  if (s->breath_rate > 0) move_vessel(s, h);
  if (s->wall_stiffness > 0 && s->rod) { /* its models differ in the timestep alone, and share what contacts are made with */
    for (int g = s->first_geom; g <= s->last_geom; g++) {
      model->geom_solref[mjNREF * g] = -model->geom_solimp[mjNIMP * g] / (h * h);
      model->geom_solref[mjNREF * g + 1] = -model->geom_solimp[mjNIMP * g] / h;
    }
  }
  for (int i = 0; i < FIRST_HALF; i++) engine->first_half[i](model, d);
  if (s->breath_rate > 0) move_walls(s);
  if (s->wall_stiffness > 0) {
    const double compliance = 1 / (3 * h * h * s->wall_stiffness);
    engine->forward(model, d, mjSTAGE_VEL, 1);
    for (int i = 0; i < d->ncon; i++) {
      mjContact* c = d->contact + i;
      if (c->geom[1] < s->vessel_geom || c->geom[1] > s->vessel_geom + s->hulls || c->efc_address < 0) continue;
      const double diagonal = d->efc_diagA[c->efc_address], impedance = diagonal / (diagonal + compliance);
      c->solimp[0] = c->solimp[1] = impedance;
      c->solref[0] = -impedance / (h * h);
      c->solref[1] = -impedance / h;
    }
  }
  finish_step(s, engine, model);
}

/* `count` steps of `model`, which last `share` of the control step together; returns the penetration after them. */
static double step_finely(const Simulation* s, const Engine* engine, const Account* a, const mjModel* model, int count,
                          double share) {
  for (int i = 0; i < count; i++) {
    step_engine(s, engine, model);
    enter_forces(s, engine, a, share / count);
  }
  engine->kinematics(model, s->data);
  return cathsim_penetration(s, 3);
}

/* One substep. A wire that snaps free crosses a millimetre in one long substep and is found inside the wall: such a
 * substep is taken back and repeated in `refinement` shorter ones; so is one that left a state that is not finite. A
 * tip that was hooked at an ostium comes at 0.6 m/s and crosses as much in one of those: they are taken back in turn.
 * Returns whether anything was. */
static int substep(Simulation* s, const Engine* engine, const Account* account, double share) {
  mjData* d = s->data;
  if (s->refinement <= 1) {
    step_engine(s, engine, s->model);
    enter_forces(s, engine, account, share);
    return 0;
  }
  Before before;
  keep_state(s, &before);
  const int invalid_before = warnings(d);
  step_engine(s, engine, s->model);
  engine->kinematics(s->model, d);
  double depth = cathsim_penetration(s, 3);
  const int repeat = (depth > s->tolerance && depth > s->depth + s->rise) || warnings(d) > invalid_before;
  if (repeat) {
    keep_account(account, &before);
    take_back_state(s, &before);
    depth = step_finely(s, engine, account, s->fine, s->refinement, share);
    if (depth > s->deep * s->tolerance && depth > s->depth + s->rise) {
      take_back_account(account, &before);
      take_back_state(s, &before);
      depth = step_finely(s, engine, account, s->finest, s->refinement * s->refinement, share);
    }
  } else {
    enter_forces(s, engine, account, share);
  }
  s->depth = depth;
  return repeat;
}

/* Advances by `substeps` while the controls (nu) go linearly from one value to the other. `points` and `forces`
 * (capacity x 3) hold the contacts of the substep with the largest force, `scratch` has memory for twice both; `depths`
 * (substeps) the penetration after each substep, or NULL. */
void cathsim_step(Simulation* s, const Engine* engine, int substeps, const double* control_from,
                  const double* control_to, int capacity, double* points, double* forces, double* scratch,
                  double* depths, StepSummary* summary) {
  mjData* d = s->data;
  memset(summary, 0, sizeof *summary);
  summary->force_max = -1;
  double* part[4];
  for (int k = 0; k < 4; k++) part[k] = scratch + 3 * capacity * k;
  const Account account = {capacity, points, forces, part[0], part[1], part[2], part[3], summary};
  for (int i = 0; i < substeps; i++) {
    const double t = (i + 1.0) / substeps;
    for (int k = 0; k < s->model->nu; k++) d->ctrl[k] = control_from[k] + t * (control_to[k] - control_from[k]);
    if (s->rod) rod_update(s->rod, d, t);
    if (s->drag) apply_drag(s, engine, i == 0);
    summary->refined += substep(s, engine, &account, 1.0 / substeps);
    if (s->depth_samples > 0) {
      if (s->refinement <= 1) engine->kinematics(s->model, d);
      const double depth = cathsim_penetration(s, s->depth_samples);
      if (depth > summary->penetration_max) summary->penetration_max = depth;
      if (depths) depths[i] = depth;
    }
  }
  if (s->refinement <= 1) engine->kinematics(s->model, d);
  if (s->rod) rod_report(s->rod, d);
  summary->warnings = warnings(d);
  if (!(summary->force_max >= 0)) summary->force_max = 0; /* NaN forces: the warnings tell */
}
