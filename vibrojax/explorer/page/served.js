// The page of a server that computes (--live).
import { begin, held, heldSource } from "./begin.js";
import { serverSource } from "./live.js";

begin({ ...heldSource(), ...serverSource(held.live) });
