/* Stand-in: the app's own task. */
#pragma once

void appMain(void);
