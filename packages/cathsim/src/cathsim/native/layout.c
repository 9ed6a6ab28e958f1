/* What this code, compiled against MuJoCo's headers, sees in a model and its data: compared with the running library. */
#include <stdint.h>

#include "vessel.h"

/* Digest of the sources this was built from. */
const char* cathsim_sources(void) { return CATHSIM_SOURCES; }

int cathsim_header_version(void) { return mjVERSION_HEADER; }

/* Fills `seen` (40 numbers) in the order that contact/native.py lists. */
void cathsim_layout(const mjModel* m, const mjData* d, int64_t* seen) {
  int i = 0;
  seen[i++] = m->nq;
  seen[i++] = m->nv;
  seen[i++] = m->nu;
  seen[i++] = m->ngeom;
  seen[i++] = m->nuser_geom;
  seen[i++] = (int64_t)(m->opt.timestep * 1e9 + 0.5);
  seen[i++] = (int64_t)(intptr_t)m->geom_size;
  seen[i++] = (int64_t)(intptr_t)m->geom_user;
  seen[i++] = d->ncon;
  seen[i++] = (int64_t)(d->time * 1e9 + 0.5);
  seen[i++] = (int64_t)(intptr_t)d->qpos;
  seen[i++] = (int64_t)(intptr_t)d->qvel;
  seen[i++] = (int64_t)(intptr_t)d->ctrl;
  seen[i++] = (int64_t)(intptr_t)d->qacc_warmstart;
  seen[i++] = (int64_t)(intptr_t)d->geom_xpos;
  seen[i++] = (int64_t)(intptr_t)d->geom_xmat;
  seen[i++] = d->ncon > 0 ? (int64_t)(d->contact[0].pos[0] * 1e9) : 0;
  seen[i++] = d->ncon > 0 ? d->contact[0].geom[1] : 0;
  seen[i++] = d->ncon > 0 ? d->contact[0].efc_address : 0;
  seen[i++] = (int64_t)(intptr_t)m->geom_bodyid;
  seen[i++] = (int64_t)(intptr_t)m->body_mass;
  seen[i++] = (int64_t)(intptr_t)d->xanchor;
  seen[i++] = (int64_t)(intptr_t)d->xaxis;
  seen[i++] = (int64_t)(intptr_t)d->qfrc_applied;
  seen[i++] = (int64_t)(intptr_t)d->efc_diagA;
  seen[i++] = d->ncon > 0 ? (int64_t)(d->contact[0].solref[0] * 1e9) : 0;
  seen[i++] = d->ncon > 0 ? (int64_t)(d->contact[0].solimp[0] * 1e9) : 0;
  seen[i++] = d->ncon > 0 ? (int64_t)(d->contact[0].surfacevel[0] * 1e9) : 0;
  seen[i++] = m->nuserdata;
  seen[i++] = m->nuserdata > 0 ? (int64_t)(intptr_t)d->userdata : 0;
  seen[i++] = d->nefc;
  seen[i++] = (int64_t)(intptr_t)m->M_rowadr;
  seen[i++] = (int64_t)(intptr_t)d->qH;
  seen[i++] = (int64_t)(intptr_t)d->qHDiagInv;
  seen[i++] = (int64_t)(intptr_t)d->qacc_smooth;
  seen[i++] = (int64_t)(intptr_t)d->efc_J;
  seen[i++] = (int64_t)(intptr_t)d->efc_D;
  seen[i++] = (int64_t)(intptr_t)d->efc_aref;
  seen[i++] = (int64_t)(intptr_t)d->efc_force;
  seen[i++] = d->ncon > 0 ? (int64_t)(d->contact[0].mu * 1e9) : 0;
}

/* Size (bytes) of a model's structure. */
int cathsim_model_size(void) { return (int)sizeof(mjModel); }

/* Makes `twin` (memory for one) a model with all arrays of `m` and a timestep (s) of its own: what is written to one shows
 * in the other. It is valid as long as `m` is, and is not to be freed by MuJoCo. */
void cathsim_model_twin(const mjModel* m, double timestep, mjModel* twin) {
  *twin = *m;
  twin->opt.timestep = timestep;
}
