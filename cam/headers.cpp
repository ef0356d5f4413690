#include "cam/toolpath.h"
