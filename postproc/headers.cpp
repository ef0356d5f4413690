#include "postproc/program.h"
