/* The composite rod of a wire in a catheter. Where both are there, EI and moments add; each device bends at rest in a plane
 * that its own twist turns. Twist has no inertia: it follows the balance of the devices' torsion and of the bending energy. */
#include "rod.h"

#include <math.h>
#include <string.h>

#define STEP 1e-3      /* of the integrals along the chain, m */
#define ITERATIONS 2   /* of the twist in a substep */
#define SLIDE 2e-4     /* half the difference of leads from which the feeder's force is computed, m */

/* Where a device's tip lies behind the chain's end, m. */
static double setback(int device, double lead) {
  return device == ROD_WIRE ? (lead < 0 ? -lead : 0) : (lead > 0 ? lead : 0);
}

typedef struct {
  double bending, curvature[2];
} Section;

static Section section_at(const Device* d, double from_tip) {
  const double at = from_tip / d->spacing;
  const int last = d->count - 1;
  const int i = at >= last ? last : (int)at;
  Section s = {d->bending[i], {d->curvature[2 * i], d->curvature[2 * i + 1]}};
  if (i < last) {
    const double t = at - i;
    s.bending += t * (d->bending[i + 1] - s.bending);
    for (int k = 0; k < 2; k++) s.curvature[k] += t * (d->curvature[2 * i + 2 + k] - s.curvature[k]);
  }
  return s;
}

static double torsion_at(const Device* d, double from_tip) {
  const double at = from_tip > 0 ? from_tip / d->spacing : 0;
  const int last = d->count - 1, i = at >= last ? last : (int)at;
  return i < last ? d->torsion[i] + (at - i) * (d->torsion[i + 1] - d->torsion[i]) : d->torsion[last];
}

/* Adds the integrals over low..high (distances from the chain's end, m) where the same devices are there throughout;
 * `bends`: whether its own bending counts, or only what it contributes to the joint's rest. */
static void add_piece(const Rod* rod, const double back[ROD_DEVICES], double low, double high, int bends, Cell* cell) {
  const Device* present[ROD_DEVICES];
  int uniform = 1;
  for (int d = 0; d < ROD_DEVICES; d++) {
    present[d] = rod->device[d] && low >= back[d] - 1e-12 ? rod->device[d] : NULL;
    if (present[d] && low - back[d] < (present[d]->count - 1) * present[d]->spacing) uniform = 0;
  }
  const int parts = uniform ? 1 : (int)ceil((high - low) / STEP - 1e-6);
  const double ds = (high - low) / parts;
  for (int i = 0; i < parts; i++) {
    const double s = low + (i + 0.5) * ds;
    Section of[ROD_DEVICES] = {{0, {0, 0}}, {0, {0, 0}}};
    double bending = 0, relaxation = 0;
    for (int d = 0; d < ROD_DEVICES; d++) {
      if (!present[d]) continue;
      of[d] = section_at(present[d], s - back[d] > 0 ? s - back[d] : 0);
      bending += of[d].bending;
      relaxation += of[d].bending * present[d]->relaxation;
    }
    const double per = ds / bending;
    for (int d = 0; d < ROD_DEVICES; d++)
      for (int k = 0; k < 2; k++) cell->rest[d][k] += of[d].bending * of[d].curvature[k] * per;
    const double both = of[0].bending * of[1].bending * per;
    const double *w = of[0].curvature, *c = of[1].curvature;
    cell->mixed[0] += both * (w[0] * c[0] + w[1] * c[1]);
    cell->mixed[1] += both * (w[1] * c[0] - w[0] * c[1]);
    cell->own += 0.5 * both * (w[0] * w[0] + w[1] * w[1] + c[0] * c[0] + c[1] * c[1]);
    if (bends) {
      cell->flexibility += per;
      cell->relaxation += relaxation * per;
    }
  }
}

static void add_stretch(const Rod* rod, const double back[ROD_DEVICES], double low, double high, int bends, Cell* cell) {
  const double edge = back[0] > back[1] ? back[0] : back[1]; /* the shorter device's tip: the only step in between */
  if (edge > low && edge < high) {
    add_piece(rod, back, low, edge, bends, cell);
    low = edge;
  }
  if (high > low) add_piece(rod, back, low, high, bends, cell);
}

static void fill_cell(const Rod* rod, double lead, int joint, Cell* cell) {
  const double back[ROD_DEVICES] = {setback(ROD_WIRE, lead), setback(ROD_CATHETER, lead)};
  const double at = rod->from_end[joint], low = at - rod->after[joint], high = at + rod->before[joint];
  memset(cell, 0, sizeof *cell);
  add_stretch(rod, back, low, high, 1, cell);
  cell->bending_length = high - low;
  cell->relaxation /= cell->bending_length;
  /* no joint stands for the last half link: its rest is the last joint's */
  if (joint == rod->joints - 1) add_stretch(rod, back, 0, low, 0, cell);
}

/* Share of low..high (from the chain's end) where a device is. */
static double share_of(const Rod* rod, int device, double lead, double low, double high) {
  if (!rod->device[device]) return 0;
  const double start = setback(device, lead);
  if (start <= low) return 1;
  return start >= high ? 0 : (high - start) / (high - low);
}

static void fill_links(const Rod* rod, double lead) {
  mjModel* m = rod->model;
  double low = 0, subtree = 0;
  for (int i = rod->links - 1; i >= 0; i--) {
    const double length = rod->lengths[i], high = low + length;
    double share[ROD_DEVICES], mass = 0, around = 0;
    for (int d = 0; d < ROD_DEVICES; d++) {
      share[d] = share_of(rod, d, lead, low, high);
      if (share[d] == 0) continue;
      const Device* device = rod->device[d];
      mass += share[d] * device->mass * length;
      around += 0.5 * share[d] * device->mass * length * device->radius * device->radius;
    }
    const double covered = share[ROD_CATHETER];
    const Device *outer = rod->device[ROD_CATHETER], *inner = rod->device[ROD_WIRE];
    const double thick = outer ? outer->radius : 0, thin = inner ? inner->radius : thick;
    const double rough = outer ? outer->friction : 0, smooth = inner ? inner->friction : rough;
    const int g = rod->first_geom + i, b = rod->first_body + i;
    m->geom_size[3 * g] = thin + covered * (thick - thin);
    m->geom_friction[3 * g] = smooth + covered * (rough - smooth);
    m->body_mass[b] = mass;
    m->body_inertia[3 * b] = m->body_inertia[3 * b + 1] = mass * length * length / 12 + around / 2;
    m->body_inertia[3 * b + 2] = around;
    subtree += mass;
    m->body_subtreemass[b] = subtree;
    for (int k = 0; k < 2; k++) {
      const double alone = rod->inverse_weight[2 * i + k];
      m->body_invweight0[2 * b + k] = alone + covered * (rod->inverse_weight[2 * (rod->links + i) + k] - alone);
    }
    low = high;
  }
}

static void show(Rod* rod) {
  if (rod->shown == rod->lead) return;
  mjModel* m = rod->model;
  for (int j = 0; j < rod->joints; j++) {
    Cell* cell = rod->cells + j;
    fill_cell(rod, rod->lead, j, cell);
    for (int k = 0; k < 2; k++) {
      const int joint = rod->first_joint + 2 * j + k;
      m->jnt_stiffness[joint] = 1 / cell->flexibility;
      m->dof_damping[m->jnt_dofadr[joint]] = cell->relaxation / cell->flexibility;
    }
  }
  fill_links(rod, rod->lead);
  rod->shown = rod->lead;
}

/* Bend of a joint, rad: about x and y. */
static const double* bend_of(const Rod* rod, const mjData* data, int joint) {
  return data->qpos + rod->model->jnt_qposadr[rod->first_joint + 2 * joint];
}

/* Angle by which a joint's two hinges, one after the other, turn the link about its own axis, rad. */
static double own_turn(const double bend[2]) { return 2 * atan(tan(0.5 * bend[0]) * tan(0.5 * bend[1])); }

/* Cosine and sine of a device's twist at each joint, of the moment when `spin` was called. */
static double* spins_of(const Rod* rod, int device) { return rod->workspace + (4 + 2 * device) * rod->joints; }

static void spin(const Rod* rod, int device) {
  double* spins = spins_of(rod, device);
  for (int j = 0; j < rod->joints; j++) {
    spins[2 * j] = cos(rod->twist[device][j]);
    spins[2 * j + 1] = sin(rod->twist[device][j]);
  }
}

/* A device's rest bend at a joint, turned by an angle that is given by its cosine and sine. */
static void turned(const double rest[2], const double by[2], double result[2]) {
  result[0] = by[0] * rest[0] - by[1] * rest[1];
  result[1] = by[1] * rest[0] + by[0] * rest[1];
}

/* The coupling of both rest curvatures at a joint, turned by the angle between the devices. */
static void coupling(const Rod* rod, const Cell* cell, int joint, double result[2]) {
  const double *w = spins_of(rod, ROD_WIRE) + 2 * joint, *c = spins_of(rod, ROD_CATHETER) + 2 * joint;
  const double between[2] = {w[0] * c[0] + w[1] * c[1], w[1] * c[0] - w[0] * c[1]};
  turned(cell->mixed, between, result);
}

/* Derivative of a joint's energy of bending by one device's turn, N m, and a bound of its second one. */
static double turning(const Rod* rod, const double bend[2], int joint, int device, double* curvature) {
  const Cell* cell = rod->cells + joint;
  const int other = 1 - device;
  const double k = 1 / cell->flexibility;
  double mine[2], theirs[2], mixed[2];
  turned(cell->rest[device], spins_of(rod, device) + 2 * joint, mine);
  turned(cell->rest[other], spins_of(rod, other) + 2 * joint, theirs);
  coupling(rod, cell, joint, mixed);
  const double left[2] = {bend[0] - theirs[0], bend[1] - theirs[1]};
  *curvature = k * sqrt((left[0] * left[0] + left[1] * left[1]) * (mine[0] * mine[0] + mine[1] * mine[1])) +
               sqrt(mixed[0] * mixed[0] + mixed[1] * mixed[1]);
  const double sign = device == ROD_WIRE ? 1 : -1;
  return k * (left[0] * mine[1] - left[1] * mine[0]) + sign * mixed[1];
}

/* Where the hub's angle stands in the frame of the chain's first link, rad. */
static double hub_angle(const Rod* rod, const mjData* data, int device) {
  return rod->hub[device] - (rod->rotation < 0 ? 0 : data->qpos[rod->rotation]);
}

/* Stiffness of torsion between a joint and the next one proximally, or the hub, N m/rad. */
static double torsion_before(const Rod* rod, int device, int joint) {
  const Device* d = rod->device[device];
  const double back = setback(device, rod->lead), at = rod->from_end[joint];
  if (joint > 0) return torsion_at(d, 0.5 * (at + rod->from_end[joint - 1]) - back) / (rod->from_end[joint - 1] - at);
  const double shaft = d->length - (at - back);
  return torsion_at(d, at - back + 0.5 * shaft) / (shaft > 0.01 ? shaft : 0.01);
}

/* How far the frames on both sides of a stretch are turned against each other by the hinges, rad. */
static double frame_turn(const double* turns, int joint) {
  return joint > 0 ? 0.5 * (turns[joint - 1] + turns[joint]) : 0.5 * turns[0];
}

/* One iteration of a device's twist at fixed bends (a majoriser of the energy is minimised exactly, which never lets
 * the energy rise); returns the largest change, rad. */
static double relax_twist(Rod* rod, const mjData* data, int device) {
  const int n = rod->joints;
  double *turns = rod->workspace, *before = turns + n, *diagonal = before + n, *right = diagonal + n;
  double* twist = rod->twist[device];
  const double hub = hub_angle(rod, data, device);
  for (int j = 0; j < n; j++) before[j] = torsion_before(rod, device, j);
  for (int j = 0; j < n; j++) {
    double curvature;
    const double slope = turning(rod, bend_of(rod, data, j), j, device, &curvature);
    const double at_before = before[j] * (twist[j] - (j > 0 ? twist[j - 1] : hub) + frame_turn(turns, j));
    const double after = j + 1 < n ? before[j + 1] : 0;
    const double at_after = j + 1 < n ? after * (twist[j + 1] - twist[j] + frame_turn(turns, j + 1)) : 0;
    diagonal[j] = curvature + before[j] + after;
    right[j] = -(slope + at_before - at_after);
  }
  for (int j = 1; j < n; j++) {
    const double factor = before[j] / diagonal[j - 1];
    diagonal[j] -= factor * before[j];
    right[j] += factor * right[j - 1];
  }
  double largest = 0, change = 0;
  for (int j = n - 1; j >= 0; j--) {
    change = (right[j] + (j + 1 < n ? before[j + 1] * change : 0)) / diagonal[j];
    twist[j] += change;
    if (fabs(change) > largest) largest = fabs(change);
  }
  return largest;
}

/* What a change of the twists begins with: how each link is turned by its hinges, and the spins. */
static void prepare_twists(Rod* rod, const mjData* data) {
  for (int j = 0; j < rod->joints; j++) rod->workspace[j] = own_turn(bend_of(rod, data, j));
  for (int d = 0; d < ROD_DEVICES; d++) spin(rod, d);
}

/* After `prepare_twists` with the same bends. */
static double relax_twists(Rod* rod, const mjData* data) {
  double largest = 0;
  for (int d = 0; d < ROD_DEVICES; d++) {
    if (!rod->device[d]) continue;
    if (rod->rigid) {
      double angle = hub_angle(rod, data, d);
      for (int j = 0; j < rod->joints; j++) rod->twist[d][j] = angle -= frame_turn(rod->workspace, j);
    } else {
      const double change = relax_twist(rod, data, d);
      if (change > largest) largest = change;
    }
    spin(rod, d);
  }
  return largest;
}

/* Twisting moment of all devices at each joint, N m: what twists a joint's bends. */
static void twisting_moments(Rod* rod, const mjData* data, double* moments) {
  double distal = 0, curvature;
  for (int j = rod->joints - 1; j >= 0; j--) {
    double here = 0;
    for (int d = 0; d < ROD_DEVICES; d++)
      if (rod->device[d]) here -= turning(rod, bend_of(rod, data, j), j, d, &curvature);
    moments[j] = distal + 0.5 * here; /* mean of both sides */
    distal += here;
  }
}

static void set_rest(Rod* rod, const mjData* data) {
  mjModel* m = rod->model;
  double* moments = rod->workspace + rod->joints;
  twisting_moments(rod, data, moments);
  for (int j = 0; j < rod->joints; j++) {
    const Cell* cell = rod->cells + j;
    const double* bend = bend_of(rod, data, j);
    double rest[2] = {0, 0}, part[2];
    for (int d = 0; d < ROD_DEVICES; d++) {
      if (!rod->device[d]) continue;
      turned(cell->rest[d], spins_of(rod, d) + 2 * j, part);
      for (int k = 0; k < 2; k++) rest[k] += part[k];
    }
    const double tx = tan(0.5 * bend[0]), ty = tan(0.5 * bend[1]), below = 1 + tx * tx * ty * ty;
    const double by[2] = {ty * (1 + tx * tx) / below, tx * (1 + ty * ty) / below};
    for (int k = 0; k < 2; k++) { /* beyond 1 only in a joint that is folded by more than a right angle: a pole at pi */
      const double share = by[k] > 1 ? 1 : by[k] < -1 ? -1 : by[k];
      m->qpos_spring[m->jnt_qposadr[rod->first_joint + 2 * j + k]] = rest[k] - moments[j] * share * cell->flexibility;
    }
  }
}

void rod_update(Rod* rod, const mjData* data, double share) {
  rod->lead = share < 1 ? rod->lead_from + share * (rod->lead_to - rod->lead_from) : rod->lead_to;
  for (int d = 0; d < ROD_DEVICES; d++)
    rod->hub[d] = share < 1 ? rod->hub_from[d] + share * (rod->hub_to[d] - rod->hub_from[d]) : rod->hub_to[d];
  show(rod);
  prepare_twists(rod, data);
  for (int i = 0; i < (rod->rigid ? 1 : ITERATIONS); i++) relax_twists(rod, data);
  set_rest(rod, data);
}

int rod_untwist(Rod* rod, const mjData* data, int most, double tolerance) {
  int i = 0;
  show(rod);
  prepare_twists(rod, data);
  while (i < most) {
    i++;
    if (!(relax_twists(rod, data) > tolerance)) break;
  }
  set_rest(rod, data);
  return i;
}

double rod_energy(const Rod* rod, const mjData* data, double lead) {
  double energy = 0;
  for (int d = 0; d < ROD_DEVICES; d++) spin(rod, d);
  for (int j = 0; j < rod->joints; j++) {
    Cell cell;
    fill_cell(rod, lead, j, &cell);
    const double* bend = bend_of(rod, data, j);
    double left[2] = {bend[0], bend[1]}, part[2];
    for (int d = 0; d < ROD_DEVICES; d++) {
      if (!rod->device[d]) continue;
      turned(cell.rest[d], spins_of(rod, d) + 2 * j, part);
      for (int k = 0; k < 2; k++) left[k] -= part[k];
    }
    coupling(rod, &cell, j, part);
    energy += 0.5 * (left[0] * left[0] + left[1] * left[1]) / cell.flexibility + cell.own - part[0];
  }
  return energy;
}

void rod_report(Rod* rod, const mjData* data) {
  double turn = 0.5 * own_turn(bend_of(rod, data, 0));
  for (int d = 0; d < ROD_DEVICES; d++) spin(rod, d);
  for (int d = 0; d < ROD_DEVICES; d++) {
    rod->feeder_force[d] = rod->hub_torque[d] = 0;
    if (!rod->device[d] || rod->rigid) continue;
    rod->hub_torque[d] = torsion_before(rod, d, 0) * (hub_angle(rod, data, d) - rod->twist[d][0] - turn);
  }
  if (rod->rigid && rod->joints > 0) {
    double curvature;
    for (int d = 0; d < ROD_DEVICES; d++)
      for (int j = 0; rod->device[d] && j < rod->joints; j++)
        rod->hub_torque[d] += turning(rod, bend_of(rod, data, j), j, d, &curvature);
  }
  if (!rod->device[ROD_WIRE] || !rod->device[ROD_CATHETER]) return;
  /* the device behind is the one that slides while the chain stays; the other one's force is the rest of the feeder's */
  const double slope =
      (rod_energy(rod, data, rod->lead + SLIDE) - rod_energy(rod, data, rod->lead - SLIDE)) / (2 * SLIDE);
  const int behind = rod->lead >= 0 ? ROD_CATHETER : ROD_WIRE;
  const double force = behind == ROD_CATHETER ? -slope : slope;
  rod->feeder_force[behind] = force;
  rod->feeder_force[1 - behind] = -force;
}
