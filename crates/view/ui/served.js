// The viewer as the program serves it.

import { openSocketEngine } from "./socket_engine.js";
import { startViewer } from "./viewer.js";

startViewer(openSocketEngine());
