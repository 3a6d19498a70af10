// The self-contained page.
import { begin, heldSource } from "./begin.js";

begin(heldSource());
