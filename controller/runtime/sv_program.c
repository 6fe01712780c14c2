#include "sv_program.h"

int32_t sv_nregister(const sv_program* program) {
  return program->ninput + program->nconst + program->ninstruction;
}
